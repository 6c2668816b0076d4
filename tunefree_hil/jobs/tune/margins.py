"""Margins of the winner and the baselines on the verify model: thousands of drives of changed cars in the batch.

The batch drives what the bus would, bit for bit, in a small share of the time; the cars as they are, which `verify` has
driven over the bus, are driven again and compared. docs/margins.md says what is driven and what verify.json holds.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, model_of, own_parameters
from tunefree_hil.bench.batch import Batch, Driven, Job
from tunefree_hil.bench.scaling import DEAD_TIME, LAG, mass_of, scaled
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.grade.margins import POINTS, SAME, WALKS, Came, Car, Margin, Walk
from tunefree_hil.jobs.running.foreign import not_ours
from tunefree_hil.jobs.running.serving import OURS

EFFECTS = ("steer_dead_time", "steer_gain", "payload", "friction")
ROUND = 128  # drives that are asked for together, at least, as long as there are so many

Vectors = Mapping[str, Mapping[str, float]]
Driving = dict[str, dict[Car, dict[str, Came]]]  # vector -> car -> scenario


class Drives(Protocol):
    """What drives jobs: a Batch, or a test's stand-in."""

    def drive(self, jobs: Sequence[Job]) -> list[Driven]: ...


class Found(NamedTuple):
    """What came out, and each vector's margins by the names of WALKS. scores: of the cars as they are.

    missing: groups of POINTS that this model cannot have, with the reason.
    """

    driven: Driving
    walked: dict[str, dict[str, Margin]]
    scores: dict[str, dict[str, float]]
    missing: dict[str, str]
    drives: int


def why_not(bench: Bench, joined: str | None = None) -> str:
    """Why the batch cannot drive this bench, '' where it can. What it finds out itself is told as an error.

    joined: what the controller of a joined bench calls itself, None where the bench's own was started.
    """
    ours = "a batch knows our controller only"
    if bench.spec.controller.command:
        return f"{ours}, not {bench.spec.controller.command[0]}"
    if joined not in (None, OURS):
        return f"{ours}, not {joined or 'a nameless one'}, which was joined"
    if lacking := not_ours(bench, own_parameters(bench)):
        return f"{ours}, which has no parameter {', '.join(lacking)}"
    kinds = sorted({fault.kind for fault in bench.spec.faults if fault.kind != "driver_override"})
    return f"a batch has no bus to put the bench file's faults on ({', '.join(kinds)})" if kinds else ""


def find_margins(
    bench: Bench, model: str, vectors: Vectors, scenarios: Sequence[ScenarioSpec], joined: str | None = None
) -> Generator[Event, None, Found | str]:
    """All drives in a batch of their own. A bench or model that a batch cannot drive: the reason, as a warning too."""
    reason = why_not(bench, joined)
    if not reason:
        try:
            with Batch(bench, model, extra_effects=EFFECTS) as batch:
                words = f"margins: {model} in the batch; where it is not compiled yet, that takes a minute first"
                yield Event("note", words)
                return (yield from drive_margins(batch, bench, model, vectors, scenarios))
        except (InputError, BenchError) as error:
            reason = f"{error.code}: {error.message.splitlines()[0]}"
    yield Event("warning", f"no margins of {model}: {reason}")
    return reason


def drive_margins(
    batch: Drives, bench: Bench, model: str, vectors: Vectors, scenarios: Sequence[ScenarioSpec]
) -> Generator[Event, None, Found]:
    """Drive all of POINTS, and each of WALKS as far as it goes, for every vector in all scenarios."""
    search = _Search(batch, bench, model, vectors, scenarios)
    search.drive([(next(iter(vectors)), SAME)])  # the first drive waits for the compiler: no part of the pace
    started, before = time.monotonic(), search.drives
    while wanted := search.wanted():
        search.drive(wanted)
        each_s = (time.monotonic() - started) / (search.drives - before)
        left = search.left()
        data = {"label": "margins", "done": search.drives, "total": search.drives + left, "eta_s": each_s * left}
        yield Event("progress", search.said(), data)
    walked = {name: {what: search.walks[name, what].found for what in WALKS} for name in vectors}
    known = {name: {what: one for what, one in some.items() if one} for name, some in walked.items()}
    return Found(search.driven, known, search.scores, search.missing, search.drives)


class _Search:
    """What has been driven, and what is next."""

    def __init__(
        self, batch: Drives, bench: Bench, model: str, vectors: Vectors, scenarios: Sequence[ScenarioSpec]
    ) -> None:
        self.batch, self.vectors, self.scenarios = batch, vectors, list(scenarios)
        self.driven: Driving = {name: {} for name in vectors}
        self.scores: dict[str, dict[str, float]] = {name: {} for name in vectors}
        self.walks = {(name, what): Walk(cars) for name in vectors for what, cars in WALKS.items()}
        self.missing: dict[str, str] = {}
        self.drives = 0
        self._mass_kg = 0.0
        self._points = [SAME, *self._possible(bench, model)]

    def wanted(self) -> list[tuple[str, Car]]:
        """The next car of each walk, filled up with the fixed ones; by car, so that vectors share what is built."""
        ahead = {(name, car): None for (name, _), walk in self.walks.items() if (car := walk.ahead) is not None}
        fixed = (one for one in self._fixed() if one not in ahead)
        least = -(-ROUND // len(self.scenarios))
        while len(ahead) < least and (one := next(fixed, None)) is not None:
            ahead[one] = None
        return sorted(ahead, key=lambda one: one[1])

    def left(self) -> int:
        """Drives that are still to be made at most."""
        walking = sum(walk.left for walk in self.walks.values())
        return len(self.scenarios) * (walking + sum(1 for _ in self._fixed()))

    def drive(self, pairs: Sequence[tuple[str, Car]]) -> None:
        """All scenarios of these vectors with these cars."""
        jobs = [self._job(name, car, scenario) for name, car in pairs for scenario in self.scenarios]
        answers = iter(self.batch.drive(jobs))
        for name, car in pairs:
            came = self.driven[name].setdefault(car, {})
            for scenario in self.scenarios:
                one = next(answers)
                came[scenario.name] = came_of(one)
                if car == SAME and one.grade is not None:
                    self.scores[name][scenario.name] = one.grade.score
        self.drives += len(jobs)
        for (name, _), walk in self.walks.items():
            while (car := walk.ahead) is not None and car in self.driven[name]:
                walk.tell(self.driven[name][car])

    def said(self) -> str:
        """Words for the progress line."""
        ended = sum(walk.found is not None for walk in self.walks.values())
        return f"{self.drives} drives, {ended} of {len(self.walks)} margins found"

    def _fixed(self) -> Iterator[tuple[str, Car]]:
        return ((name, car) for car in self._points for name in self.vectors if car not in self.driven[name])

    def _job(self, name: str, car: Car, scenario: ScenarioSpec) -> Job:
        effects: dict[str, dict[str, float]] = {}
        if car.steer_delay_s:
            effects["steer_dead_time"] = {"delay_s": car.steer_delay_s}
        if car.steer_gain != 1.0:
            effects["steer_gain"] = {"gain_frac": car.steer_gain}
        if car.mass != 1.0:
            effects["payload"] = {"mass_kg": (car.mass - 1.0) * self._mass_kg}
        if car.friction != 1.0:
            effects["friction"] = {"friction_frac": car.friction}
        scale = {key: one for key, one in ((DEAD_TIME, car.dead_time), (LAG, car.lag)) if one != 1.0}
        return Job(self.vectors[name], scenario, effects=effects, scale=scale)

    def _possible(self, bench: Bench, model: str) -> Iterator[Car]:
        """The cars of POINTS that can be made of this model; the reasons for the others into `missing`."""
        spec = model_of(bench, model)
        reasons: dict[str, str] = {}
        try:
            self._mass_kg = mass_of(spec)
        except InputError as error:
            reasons["mass"] = error.message
        try:
            scaled(spec, {DEAD_TIME: 1.1, LAG: 1.1})
        except InputError as error:
            reasons["lag"] = reasons["dead_time"] = error.message
        for group, cars in POINTS.items():
            changed = [field for field in reasons if any(getattr(car, field) != 1.0 for car in cars)]
            if changed:
                self.missing[group] = reasons[changed[0]]
            else:
                yield from cars


def came_of(driven: Driven) -> Came:
    """A drive that the bench and not the parameters ended is named by its error, and is no good drive either."""
    return Came(driven.grade.outcome, driven.grade.replans) if driven.grade else Came(driven.error, 0)
