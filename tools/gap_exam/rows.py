"""The cases of an exam: all rows of its table, drawn from its domain, under numbers that say nothing."""

from __future__ import annotations

import itertools
from typing import NamedTuple

from tools.gap_exam.cases import Case, Effects, draw_effect
from tools.gap_exam.catalogue import EFFECTS, OUTSIDE, kind_of, same_class
from tools.gap_exam.driver import CONTROLLER, PERSON
from tools.gap_exam.seeds import Domain
from tools.gap_exam.semi_real import LEAST_SIZE, SOURCES, names_of

POOL = 24  # vehicles
KINDS, DRIVERS = ("ordinary", "excited"), (PERSON, CONTROLLER)
REFERENCE_S = 180.0
ROUNDS, PER_ROUND = 3, 3  # of the bisection of an effect's size: 9 logs, and those of the row `one` beside them


class LogSpec(NamedTuple):
    """A log that a model is made from."""

    kind: str
    who: int
    seed: int
    duration_s: float
    effects: Effects


class Model(NamedTuple):
    """A model that the examined program makes before the exam. kind: 'physics' or 'hybrid'."""

    name: str
    vehicle: int
    kind: str
    logs: tuple[LogSpec, ...]


class Exam(NamedTuple):
    """All of it."""

    domain: Domain
    cases: tuple[Case, ...]
    models: dict[str, Model]


class Counts(NamedTuple):
    """How many of what; the defaults are the exam of the issue."""

    one: int = 7  # vehicles an effect: three in four logs are detectable, which leaves about 240
    free: int = 300
    outside: int = 6  # vehicles a kind
    two: int = 30  # of other subsystems, and as many of the same
    start_b: int = 60
    start_c: int = 60
    start_d: int = 24
    limits: int = ROUNDS * PER_ROUND  # of each effect, for the smallest that is named


SAMPLE_SIZE = 24
ROWS = ("one", "free", "outside", "two", "start_b", "start_c", "start_d", "semi", "limits")


class _Draw:
    """Collects cases; every one gets a vehicle, a way of driving and a seed by its place in its row."""

    def __init__(self, domain: Domain) -> None:
        self.domain = domain
        self.cases: list[Case] = []
        self.models: dict[str, Model] = {}

    def add(
        self, row: str, place: int, effects: Effects, vehicle: int, model: str = "", *, rung: int = -1, within: int = -1
    ) -> None:
        """One more case; ways of driving go round in an order that has nothing to do with vehicle or effect."""
        turn = int(self.domain.rng(row, place, "way").integers(4))
        kind, who = KINDS[turn % 2], DRIVERS[turn // 2]
        if row == "limits":
            kind = "excited"
        model = model or self.clean(vehicle)
        seed = self.domain.seed(row, place)
        self.cases.append(Case(-1, row, vehicle, model, kind, who, effects, seed, rung=rung, place=within))

    def clean(self, vehicle: int) -> str:
        """The model of a vehicle calibrated on its effect-free logs."""
        return self.model(f"v{vehicle:02d}", vehicle, "physics", {}, 2)

    def model(self, name: str, vehicle: int, kind: str, effects: Effects, logs: int) -> str:
        """Remember that a model is needed; its logs are excited and ordinary drives in turn."""
        if name not in self.models:
            specs = (
                LogSpec(KINDS[1 - i % 2], CONTROLLER, self.domain.seed("model", name, i), REFERENCE_S, effects)
                for i in range(logs)
            )
            self.models[name] = Model(name, vehicle, kind, tuple(specs))
        return name

    def effect(self, name: str, *path: object, size: float | None = None) -> dict[str, float]:
        return draw_effect(name, self.domain.rng("effect", name, *path), size)

    def vehicles(self, *path: object) -> list[int]:
        """The pool in an order of its own."""
        return [int(i) for i in self.domain.rng("order", *path).permutation(POOL)]


def exam_of(domain: Domain, counts: Counts = Counts(), rows: tuple[str, ...] = ROWS) -> Exam:  # noqa: B008
    """The exam of a domain. rows: those to be had; a case is the same whichever others there are, but its number."""
    draw = _Draw(domain)
    makers = {"one": _one, "free": _free, "outside": _outside, "two": _two, "start_b": _start_b, "start_c": _start_c,
              "start_d": _start_d, "semi": _semi, "limits": _limits}  # fmt: skip
    for row in rows:
        makers[row](draw, counts)
    return _numbered(draw)


def sample_of(domain: Domain) -> Exam:
    """24 one-effect logs, every effect at most once."""
    draw = _Draw(domain)
    names = domain.rng("sample").permutation(sorted(EFFECTS))[:SAMPLE_SIZE]
    vehicles = draw.vehicles("sample")
    for place, name in enumerate(map(str, names)):
        draw.add("one", place, {name: draw.effect(name, "sample")}, vehicles[place % 4])
    return _numbered(draw)


def _numbered(draw: _Draw) -> Exam:
    """Cases and models under numbers that do not say what they are for."""
    order = draw.domain.rng("numbers", len(draw.cases)).permutation(len(draw.cases))
    used = sorted({case.model for case in draw.cases if case.model})
    called = {used[i]: f"m{k:02d}" for k, i in enumerate(draw.domain.rng("models", len(used)).permutation(len(used)))}
    cases = [draw.cases[i]._replace(number=n, model=called.get(draw.cases[i].model, "")) for n, i in enumerate(order)]
    models = {called[name]: draw.models[name]._replace(name=called[name]) for name in used}
    return Exam(draw.domain, tuple(cases), models)


def _one(draw: _Draw, counts: Counts) -> None:
    for i, name in enumerate(EFFECTS):
        vehicles = draw.vehicles("one", name)
        for j in range(counts.one):
            draw.add("one", i * counts.one + j, {name: draw.effect(name, "one", j)}, vehicles[j % POOL])


def _free(draw: _Draw, counts: Counts) -> None:
    """Nothing is hidden; every second vehicle has a background mismatch."""
    vehicles = draw.vehicles("free")
    for place in range(counts.free):
        draw.add("free", place, {}, vehicles[place % POOL])


def _outside(draw: _Draw, counts: Counts) -> None:
    for i, name in enumerate(OUTSIDE):
        vehicles = draw.vehicles("outside", name)
        for j in range(counts.outside):
            draw.add("outside", i * counts.outside + j, {name: draw.effect(name, "outside", j)}, vehicles[j % POOL])


def _two(draw: _Draw, counts: Counts) -> None:
    """Pairs of other and of the same subsystem; both effects clearly there (sizes from the upper half)."""
    pairs = [(a, b) for a, b in itertools.combinations(EFFECTS, 2) if not same_class(a, b)]
    vehicles = draw.vehicles("two")
    for same in (False, True):
        fitting = [pair for pair in pairs if (kind_of(pair[0]).subsystem == kind_of(pair[1]).subsystem) == same]
        chosen = draw.domain.rng("two", same).permutation(len(fitting))
        for j in range(counts.two):
            rng = draw.domain.rng("two", same, j)
            names = fitting[chosen[j % len(fitting)]]
            effects = {name: draw.effect(name, "two", same, j, size=rng.uniform(0.45, 0.95)) for name in names}
            draw.add("two_same" if same else "two_other", j, effects, vehicles[(2 * j + same) % POOL])


def _start_b(draw: _Draw, counts: Counts) -> None:
    """The model was calibrated on logs that already contain the effect; two logs a model."""
    names = draw.domain.rng("start_b").permutation(sorted(EFFECTS))
    for place in range(counts.start_b):
        group = place // 2
        name, vehicle = str(names[group % len(names)]), draw.vehicles("start_b")[group % POOL]
        effects = {name: draw.effect(name, "start_b", group)}
        draw.add("start_b", place, effects, vehicle, draw.model(f"b{group:02d}", vehicle, "physics", effects, 2))


def _start_c(draw: _Draw, counts: Counts) -> None:
    """A learned plant from clean logs; ten logs a model."""
    vehicles = draw.vehicles("start_c")
    names = draw.domain.rng("start_c").permutation(sorted(EFFECTS))
    for place in range(counts.start_c):
        vehicle = vehicles[place // 10 % POOL]
        name = str(names[place % len(names)])
        model = draw.model(f"c{place // 10:02d}", vehicle, "hybrid", {}, 5)
        draw.add("start_c", place, {name: draw.effect(name, "start_c", place)}, vehicle, model)


def _start_d(draw: _Draw, counts: Counts) -> None:
    """A learned plant from logs with the effect; six logs a model."""
    vehicles = draw.vehicles("start_d")
    names = draw.domain.rng("start_d").permutation(sorted(EFFECTS))
    for place in range(counts.start_d):
        group = place // 6
        name, vehicle = str(names[group]), vehicles[group % POOL]
        effects = {name: draw.effect(name, "start_d", group)}
        model = draw.model(f"d{group:02d}", vehicle, "hybrid", effects, 5)
        draw.add("start_d", place, effects, vehicle, model)


def _semi(draw: _Draw, counts: Counts) -> None:
    """Recordings of real cars with an effect written into them, and the recordings as they are."""
    for source in SOURCES:
        for j, name in enumerate((*names_of(source), "")):
            size = draw.domain.rng("semi", source, j).uniform(LEAST_SIZE, 1.0)
            effects = {name: draw.effect(name, "semi", source, j, size=size)} if name else {}
            row, seed = "semi" if name else "semi_free", draw.domain.seed("semi", source, j)
            draw.cases.append(Case(-1, row, -1, "", "recorded", 0, effects, seed, source=source))


def _limits(draw: _Draw, counts: Counts) -> None:
    """Every effect at sizes that are found by bisection (ladder.py), each log another vehicle."""
    for i, name in enumerate(EFFECTS):
        vehicles = draw.vehicles("limits", name)
        for j in range(counts.limits):
            draw.add("limits", i * counts.limits + j, {name: draw.effect(name, "limits", j, size=0.5)}, vehicles[j],
                     rung=j // PER_ROUND, within=j % PER_ROUND)  # fmt: skip
