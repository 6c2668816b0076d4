"""Margins of the winner and the baselines on the verify model: thousands of drives of changed cars in the batch.

The batch drives what the bus would, bit for bit, in a small share of the time; the cars as they are, which `verify` has
driven over the bus, are driven again and compared. docs/margins.md says what is driven and what verify.json holds.

What margins come to: plain data for verify.json (docs/margins.md), and whether the winner has less of any.

Margins as a sentence's end and as a table, from the data of margins_report.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, model_of, own_parameters
from tunefree_hil.bench.batch import Batch, Driven, Job
from tunefree_hil.bench.scaling import DEAD_TIME, LAG, mass_of, scaled
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.margins import (
    DELAY,
    GAIN_DOWN,
    GAIN_UP,
    INSIDE,
    POINTS,
    SAME,
    WALKS,
    Came,
    Car,
    Margin,
    Rate,
    Walk,
    is_inside,
    is_less,
    rate_of,
    rates,
    said,
    steering_of,
)
from tunefree_hil.jobs.running.foreign import not_ours
from tunefree_hil.jobs.running.node_main import OURS
from tunefree_hil.jobs.tune.candidates import TUNED

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


LIMITS = {
    "inside_frac": INSIDE,
    "delay_cap_s": WALKS[DELAY][-1].steer_delay_s,
    "gain_up_cap": WALKS[GAIN_UP][-1].steer_gain,
    "gain_down_cap": WALKS[GAIN_DOWN][-1].steer_gain,
}
Steered = Mapping[str, Mapping[str, float] | None]  # vector -> what `steering_data` gives


def steering_data(recordings: Iterable[Recording]) -> dict[str, float] | None:
    """RMS of the steering command's rate and its reversals a second over some drives; None without that column."""
    known: list[NDArray[np.float64]] = []
    dt_s = 0.0
    for recording in recordings:
        command, dt_s = recording.get("cmd_steer_rad"), recording.dt_s
        if command is not None:
            known.append(command)
    steering = steering_of(known, dt_s) if known else None
    return steering._asdict() if steering else None


def margin_data(
    found: Found | str, steering: Steered, scores: Mapping[str, float], over_bus: Mapping[str, Mapping[str, float]]
) -> dict[str, Any]:
    """The value of "margins" in verify.json.

    found: what the drives gave, or why there were none; scores: each vector's on the verify model; over_bus: the score
    of each vector's scenarios there, which the batch must have hit.
    """
    if isinstance(found, str):
        vectors = {name: {**dict.fromkeys([*WALKS, "inside", "beyond"]), "points": []} for name in steering}
        data: dict[str, Any] = {"reason": found, "against": None, "less": [], "missing": {}, "drives": 0}
        data["same_as_bus"] = None
    else:
        vectors = {name: _vector(found, name) for name in steering}
        against = standing(scores, found)
        data = {"reason": "", "against": against, "less": less_than(vectors[TUNED], vectors.get(against or ""))}
        data |= {"missing": found.missing, "drives": found.drives, "same_as_bus": _same(found, over_bus)}
    data["vectors"] = {name: {**vectors[name], "steering": steering[name]} for name in steering}
    return {**data, "limits": LIMITS}


def standing(scores: Mapping[str, float], found: Found) -> str | None:
    """The manual vector to hold a winner's margins against: the best that drives the car as it is without a re-plan.

    None where all manual vectors re-plan or fail. A vector that re-plans as it is has no delay margin to speak of.
    """
    manual = sorted((name for name in scores if name != TUNED), key=lambda name: scores[name])
    return next((name for name in manual if found.walked[name][DELAY].value > 0.0), None)


def less_than(tuned: Mapping[str, Any], manual: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """What the winner has less of: [{"what", "tuned", "manual"}]; "inside": it fails more often within +/-20 %."""
    if manual is None:
        return []
    found = []
    for what in (DELAY, GAIN_UP, GAIN_DOWN):
        mine, other = Margin(**tuned[what]), Margin(**manual[what])
        if is_less(mine, other, down=what == GAIN_DOWN):
            found.append({"what": what, "tuned": tuned[what], "manual": manual[what]})
    if tuned["inside"]["failed"] > manual["inside"]["failed"]:
        found.append({"what": "inside", "tuned": tuned["inside"], "manual": manual["inside"]})
    return found


def _vector(found: Found, name: str) -> dict[str, Any]:
    driven = found.driven[name]
    data: dict[str, Any] = {what: margin._asdict() for what, margin in found.walked[name].items()}
    data["inside"] = _rate(rates(driven, inside=True))
    data["beyond"] = _rate(rates(driven, inside=False))
    data["points"] = [
        _point(group, car, driven[car])
        for group, cars in POINTS.items() if group not in found.missing for car in cars
    ]  # fmt: skip
    return data


def _point(group: str, car: Car, drives: Mapping[str, Came]) -> dict[str, Any]:
    rate = rate_of(drives.values())
    return {
        "group": group,
        "what": said(car),
        "factors": {field: value for field, value in car._asdict().items() if field != "steer_delay_s"},
        "inside": is_inside(car),
        **_rate(rate),
        "replanned": sum(not came.failed and not came.calm for came in drives.values()),
        "failures": {scenario: came.outcome for scenario, came in drives.items() if came.failed},
    }


def _rate(rate: Rate) -> dict[str, Any]:
    return {"failed": rate.failed, "drives": rate.drives, "share": rate.share if rate.drives else None}


def _same(found: Found, over_bus: Mapping[str, Mapping[str, float]]) -> dict[str, int]:
    """Of the drives of the cars as they are: how many scores of the batch are those of the bus, bit for bit."""
    pairs = [(found.scores[name].get(scenario), score) for name, some in over_bus.items()
             for scenario, score in some.items()]  # fmt: skip
    return {"equal": sum(mine == score for mine, score in pairs), "of": len(pairs)}


LESS = {"delay": "delay margin", "gain_up": "steer gain margin upward", "gain_down": "steer gain margin downward",
        "inside": "robustness within +/-20 %"}  # fmt: skip
HEAD = ("", "delay", "gain down", "gain up", "fails in +/-20 %", "beyond", "steering rate", "reversals")
NONE = "-"


def margin_words(margins: Mapping[str, Any], tuned: str) -> str:
    """'but with less delay margin than as_shipped: 60 ms against 110 ms', or both margins; '' where there are none.

    A winner that fails within +/-20 %, where nothing should, is said to.
    """
    if margins["reason"]:
        return ""
    less, against, mine = margins["less"], margins["against"], margins["vectors"][tuned]
    if less:
        words = "but with " + ", ".join(f"less {LESS[one['what']]} than {against}: {_pair(one)}" for one in less)
    elif against is None:
        words = f"delay margin {_delay(mine['delay'])}, and no manual vector drives all of them without a re-plan"
    else:
        words = f"delay margin {_delay(mine['delay'])} against {_delay(margins['vectors'][against]['delay'])}"
        words += f" of {against}"
    if mine["inside"]["failed"] and "inside" not in [one["what"] for one in less]:
        words += f"; it FAILS {_rate_text(mine['inside'])} drives within +/-20 %"
    return words


def margin_table(margins: Mapping[str, Any], tuned: str) -> list[str]:
    """One line a vector, '<' beside what the winner has less of than manual; then where it fails, what is missing."""
    vectors, less = margins["vectors"], {one["what"] for one in margins["less"]}
    rows = [HEAD, *(_row(name, one, less if name == tuned else set()) for name, one in vectors.items())]
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEAD))]
    lines = ["  ".join(f"{cell:>{width}}" if i else f"{cell:{width}}"
                       for i, (cell, width) in enumerate(zip(row, widths, strict=True))) for row in rows]  # fmt: skip
    if less:
        lines.append(f"< marks what {tuned} has less of than {margins['against']}")
    lines += _where(tuned, vectors[tuned]["points"])
    lines += [f"{group}: not driven, {reason}" for group, reason in margins["missing"].items()]
    if margins["reason"]:
        lines.append(f"no margins: {margins['reason']}")
    return lines


def _where(tuned: str, points: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line a scenario and end: with which cars."""
    cars: dict[tuple[str, str], list[str]] = {}
    for point in points:
        for key in point["failures"].items():
            cars.setdefault(key, []).append(point["what"])
    return [f"{tuned} fails in {scenario} ({outcome}) with {'; '.join(some)}"
            for (scenario, outcome), some in sorted(cars.items())]  # fmt: skip


def _row(name: str, one: Mapping[str, Any], less: set[str]) -> tuple[str, ...]:
    cells = {"delay": _delay(one["delay"]), "gain_down": _gain(one["gain_down"]), "gain_up": _gain(one["gain_up"]),
             "inside": _rate_text(one["inside"])}  # fmt: skip
    marked = [text + (" <" if what in less else "") for what, text in cells.items()]
    steering = one["steering"]
    rate = f"{steering['rate_rms_radps']:.3f} rad/s" if steering else NONE
    reversals = f"{steering['reversals_per_s']:.2f} /s" if steering else NONE
    return (name, *marked, _rate_text(one["beyond"], share=True), rate, reversals)


def _pair(less: Mapping[str, Any]) -> str:
    if less["what"] == "inside":
        return f"{_rate_text(less['tuned'])} drives fail against {_rate_text(less['manual'])}"
    show = _delay if less["what"] == "delay" else _gain
    return f"{show(less['tuned'])} against {show(less['manual'])}"


def _delay(margin: Mapping[str, Any] | None) -> str:
    if margin is None:
        return NONE
    return f"{'>= ' if margin['at_least'] else ''}{1e3 * margin['value']:.0f} ms"


def _gain(margin: Mapping[str, Any] | None) -> str:
    """The factor at which it is no longer calm."""
    if margin is None:
        return NONE
    beyond = "<= " if margin["value"] < 1.0 else ">= "
    return f"{beyond if margin['at_least'] else ''}{margin['value']:.2f}"


def _rate_text(rate: Mapping[str, Any] | None, *, share: bool = False) -> str:
    if rate is None or not rate["drives"]:
        return NONE
    return f"{rate['failed']} of {rate['drives']}" + (f" ({100.0 * rate['share']:.0f} %)" if share else "")
