"""Margins of the winner and of the best baseline on the verify model: thousands of drives of varied cars in the batch.

The batch gives the numbers of the bus, bit for bit, in a small share of the time. `verify` has driven the nominal car
over the bus; its scores are compared with those of the batch. docs/reference/margins.md lists the drives and the keys
of verify.json. The result is plain data, the end of a sentence, and a table.
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
    MAX_NEAR_NOMINAL,
    NOMINAL,
    POINTS,
    SWEEPS,
    CarVariant,
    DriveOutcome,
    FailureRate,
    Margin,
    MarginSearch,
    describe_variant,
    failure_rate,
    failure_rate_at_points,
    is_near_nominal,
    is_smaller_margin,
    steering_activity,
)
from tunefree_hil.jobs.running.foreign import unsupported_parameters
from tunefree_hil.jobs.running.node_main import OURS
from tunefree_hil.jobs.tune.candidates import TUNED

EFFECTS = ("steer_dead_time", "steer_gain", "payload", "friction")
MIN_DRIVES_PER_CALL = 128  # the last call may have fewer

Vectors = Mapping[str, Mapping[str, float]]
OutcomesByCar = dict[str, dict[CarVariant, dict[str, DriveOutcome]]]  # vector -> car -> scenario


class JobDriver(Protocol):
    """Drives jobs: a Batch, or a replacement in tests."""

    def drive(self, jobs: Sequence[Job]) -> list[Driven]: ...


class MarginDrives(NamedTuple):
    """Results of the drives.

    driven: Outcomes by vector, car and scenario.
    margins: By vector and name of SWEEPS.
    scores: Of the nominal car, by vector and scenario.
    missing: Groups of POINTS that cannot be made from the model, with the reason.
    drives: Number of drives.
    """

    driven: OutcomesByCar
    margins: dict[str, dict[str, Margin]]
    scores: dict[str, dict[str, float]]
    missing: dict[str, str]
    drives: int


def find_batch_obstacle(bench: Bench, joined: str | None = None) -> str:
    """Why the batch cannot drive this bench, '' where it can; other obstacles are errors of the batch itself.

    Args:
        bench: The bench.
        joined: Name of the controller of a joined bench; None where the controller of the bench file was started.
    """
    limitation = "the batch has only our controller"
    if bench.spec.controller.command:
        return f"{limitation}, not {bench.spec.controller.command[0]}"
    if joined not in (None, OURS):
        return f"{limitation}, not {joined or 'the unnamed one'}, which was joined"
    if unsupported := unsupported_parameters(bench, own_parameters(bench)):
        return f"{limitation}, which has no parameter {', '.join(unsupported)}"
    kinds = sorted({fault.kind for fault in bench.spec.faults if fault.kind != "driver_override"})
    return f"the batch has no bus for the faults of the bench file ({', '.join(kinds)})" if kinds else ""


def find_margins(
    bench: Bench, model: str, vectors: Vectors, scenarios: Sequence[ScenarioSpec], joined: str | None = None
) -> Generator[Event, None, MarginDrives | str]:
    """Make all drives in a new batch. Returns the reason where the batch cannot drive bench or model."""
    reason = find_batch_obstacle(bench, joined)
    if not reason:
        try:
            with Batch(bench, model, extra_effects=EFFECTS) as batch:
                text = f"margins: {model} in the batch; compiling it, where it is new, takes a minute"
                yield Event("note", text)
                return (yield from drive_margins(batch, bench, model, vectors, scenarios))
        except (InputError, BenchError) as error:
            reason = f"{error.code}: {error.message.splitlines()[0]}"
    yield Event("warning", f"no margins of {model}: {reason}")
    return reason


def drive_margins(
    batch: JobDriver, bench: Bench, model: str, vectors: Vectors, scenarios: Sequence[ScenarioSpec]
) -> Generator[Event, None, MarginDrives]:
    """Drive all of POINTS, and each of SWEEPS up to the margin, for every vector in all scenarios."""
    search = _MarginDriver(batch, bench, model, vectors, scenarios)
    search.drive([(next(iter(vectors)), NOMINAL)])  # not timed: the first drive waits for the compiler
    started, n_untimed = time.monotonic(), search.drives
    while pairs := search.next_cars():
        search.drive(pairs)
        each_s = (time.monotonic() - started) / (search.drives - n_untimed)
        n_left = search.max_drives_left()
        data = {"label": "margins", "done": search.drives, "total": search.drives + n_left, "eta_s": each_s * n_left}
        yield Event("progress", search.progress_text(), data)
    margins = {
        name: {sweep: margin for sweep in SWEEPS if (margin := search.sweeps[name, sweep].margin)} for name in vectors
    }
    return MarginDrives(search.driven, margins, search.scores, search.missing, search.drives)


class _MarginDriver:
    """The outcomes so far, and the choice of the next cars, for all vectors and sweeps."""

    def __init__(
        self, batch: JobDriver, bench: Bench, model: str, vectors: Vectors, scenarios: Sequence[ScenarioSpec]
    ) -> None:
        self.batch, self.vectors, self.scenarios = batch, vectors, list(scenarios)
        self.driven: OutcomesByCar = {name: {} for name in vectors}
        self.scores: dict[str, dict[str, float]] = {name: {} for name in vectors}
        self.sweeps = {(name, sweep): MarginSearch(cars) for name in vectors for sweep, cars in SWEEPS.items()}
        self.missing: dict[str, str] = {}
        self.drives = 0
        self._mass_kg = 0.0
        self._points = [NOMINAL, *self._buildable_cars(bench, model)]

    def next_cars(self) -> list[tuple[str, CarVariant]]:
        """The next car of each sweep, filled up with POINTS; sorted by car, for all vectors together."""
        pairs = {
            (name, car): None for (name, _), sweep in self.sweeps.items() if (car := sweep.next_variant) is not None
        }
        points = (pair for pair in self._open_points() if pair not in pairs)
        min_pairs = -(-MIN_DRIVES_PER_CALL // len(self.scenarios))
        while len(pairs) < min_pairs and (pair := next(points, None)) is not None:
            pairs[pair] = None
        return sorted(pairs, key=lambda pair: pair[1])

    def max_drives_left(self) -> int:
        """Upper limit of the number of remaining drives."""
        sweeps = sum(sweep.remaining for sweep in self.sweeps.values())
        return len(self.scenarios) * (sweeps + sum(1 for _ in self._open_points()))

    def drive(self, pairs: Sequence[tuple[str, CarVariant]]) -> None:
        """Drive all scenarios with these vectors and cars."""
        jobs = [self._job(name, car, scenario) for name, car in pairs for scenario in self.scenarios]
        drives = iter(self.batch.drive(jobs))
        for name, car in pairs:
            outcomes = self.driven[name].setdefault(car, {})
            for scenario in self.scenarios:
                drive = next(drives)
                outcomes[scenario.name] = outcome_from_drive(drive)
                if car == NOMINAL and drive.grade is not None:
                    self.scores[name][scenario.name] = drive.grade.score
        self.drives += len(jobs)
        for (name, _), sweep in self.sweeps.items():
            while (car := sweep.next_variant) is not None and car in self.driven[name]:
                sweep.record_outcomes(self.driven[name][car])

    def progress_text(self) -> str:
        """'1280 drives, 9 of 18 margins found'."""
        ended = sum(sweep.margin is not None for sweep in self.sweeps.values())
        return f"{self.drives} drives, {ended} of {len(self.sweeps)} margins found"

    def _open_points(self) -> Iterator[tuple[str, CarVariant]]:
        return ((name, car) for car in self._points for name in self.vectors if car not in self.driven[name])

    def _job(self, name: str, car: CarVariant, scenario: ScenarioSpec) -> Job:
        effects: dict[str, dict[str, float]] = {}
        if car.steer_delay_s:
            effects["steer_dead_time"] = {"delay_s": car.steer_delay_s}
        if car.steer_gain != 1.0:
            effects["steer_gain"] = {"gain_frac": car.steer_gain}
        if car.mass != 1.0:
            effects["payload"] = {"mass_kg": (car.mass - 1.0) * self._mass_kg}
        if car.friction != 1.0:
            effects["friction"] = {"friction_frac": car.friction}
        scale = {key: factor for key, factor in ((DEAD_TIME, car.dead_time), (LAG, car.lag)) if factor != 1.0}
        return Job(self.vectors[name], scenario, effects=effects, scale=scale)

    def _buildable_cars(self, bench: Bench, model: str) -> Iterator[CarVariant]:
        """The cars of POINTS that can be made from this model; stores the reasons for the others in `missing`."""
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


def outcome_from_drive(driven: Driven) -> DriveOutcome:
    """The outcome of a drive; where the bench ended it without a grade, the name of the error."""
    return DriveOutcome(driven.grade.outcome, driven.grade.replans) if driven.grade else DriveOutcome(driven.error, 0)


LIMITS = {
    "inside_frac": MAX_NEAR_NOMINAL,
    "delay_cap_s": SWEEPS[DELAY][-1].steer_delay_s,
    "gain_up_cap": SWEEPS[GAIN_UP][-1].steer_gain,
    "gain_down_cap": SWEEPS[GAIN_DOWN][-1].steer_gain,
}
SteeringByVector = Mapping[str, Mapping[str, float] | None]  # by vector, from `measure_steering`


def measure_steering(recordings: Iterable[Recording]) -> dict[str, float] | None:
    """RMS rate and reversals per second of the steering command over the drives; None without that column."""
    commands: list[NDArray[np.float64]] = []
    dt_s = 0.0
    for recording in recordings:
        command, dt_s = recording.get("cmd_steer_rad"), recording.dt_s
        if command is not None:
            commands.append(command)
    steering = steering_activity(commands, dt_s) if commands else None
    return steering._asdict() if steering else None


def margin_data(
    result: MarginDrives | str,
    steering: SteeringByVector,
    scores: Mapping[str, float],
    over_bus: Mapping[str, Mapping[str, float]],
) -> dict[str, Any]:
    """The value of "margins" in verify.json.

    Args:
        result: Results of the drives, or the reason why there are none.
        steering: From `measure_steering`, by vector.
        scores: Score on the verify model, by vector.
        over_bus: Score over the bus by vector and scenario, which the batch must reproduce.
    """
    if isinstance(result, str):
        vectors = {name: {**dict.fromkeys([*SWEEPS, "inside", "beyond"]), "points": []} for name in steering}
        data: dict[str, Any] = {"reason": result, "against": None, "less": [], "missing": {}, "drives": 0}
        data["same_as_bus"] = None
    else:
        vectors = {name: _vector_data(result, name) for name in steering}
        reference = select_reference_vector(scores, result)
        smaller = find_smaller_margins(vectors[TUNED], vectors.get(reference or ""))
        data = {"reason": "", "against": reference, "less": smaller}
        data |= {"missing": result.missing, "drives": result.drives, "same_as_bus": _count_equal(result, over_bus)}
    data["vectors"] = {name: {**vectors[name], "steering": steering[name]} for name in steering}
    return {**data, "limits": LIMITS}


def select_reference_vector(scores: Mapping[str, float], result: MarginDrives) -> str | None:
    """The manual vector that the margins are compared with: the best one without a re-plan in the nominal car.

    None where all manual vectors re-plan or fail: a vector that re-plans in the nominal car has no delay margin.
    """
    manual = sorted((name for name in scores if name != TUNED), key=lambda name: scores[name])
    return next((name for name in manual if result.margins[name][DELAY].value > 0.0), None)


def find_smaller_margins(tuned: Mapping[str, Any], manual: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """The margins that are smaller than the manual ones: [{"what", "tuned", "manual"}].

    "inside": the winner fails more often with factors within +/-20 %.
    """
    if manual is None:
        return []
    smaller = []
    for margin_name in (DELAY, GAIN_UP, GAIN_DOWN):
        winner, reference = Margin(**tuned[margin_name]), Margin(**manual[margin_name])
        if is_smaller_margin(winner, reference, down=margin_name == GAIN_DOWN):
            smaller.append({"what": margin_name, "tuned": tuned[margin_name], "manual": manual[margin_name]})
    if tuned["inside"]["failed"] > manual["inside"]["failed"]:
        smaller.append({"what": "inside", "tuned": tuned["inside"], "manual": manual["inside"]})
    return smaller


def _vector_data(result: MarginDrives, name: str) -> dict[str, Any]:
    driven = result.driven[name]
    data: dict[str, Any] = {what: margin._asdict() for what, margin in result.margins[name].items()}
    data["inside"] = _rate_data(failure_rate_at_points(driven, near_nominal=True))
    data["beyond"] = _rate_data(failure_rate_at_points(driven, near_nominal=False))
    data["points"] = [
        _point_data(group, car, driven[car])
        for group, cars in POINTS.items()
        if group not in result.missing
        for car in cars
    ]
    return data


def _point_data(group: str, car: CarVariant, drives: Mapping[str, DriveOutcome]) -> dict[str, Any]:
    rate = failure_rate(drives.values())
    return {
        "group": group,
        "what": describe_variant(car),
        "factors": {field: value for field, value in car._asdict().items() if field != "steer_delay_s"},
        "inside": is_near_nominal(car),
        **_rate_data(rate),
        "replanned": sum(not drive.is_failed and not drive.is_clean for drive in drives.values()),
        "failures": {scenario: drive.outcome for scenario, drive in drives.items() if drive.is_failed},
    }


def _rate_data(rate: FailureRate) -> dict[str, Any]:
    return {"failed": rate.failed, "drives": rate.drives, "share": rate.share if rate.drives else None}


def _count_equal(result: MarginDrives, over_bus: Mapping[str, Mapping[str, float]]) -> dict[str, int]:
    """How many scores of the nominal car are equal in the batch and over the bus, bit for bit."""
    pairs = [
        (result.scores[name].get(scenario), score)
        for name, scores in over_bus.items()
        for scenario, score in scores.items()
    ]
    return {"equal": sum(batch == bus for batch, bus in pairs), "of": len(pairs)}


MARGIN_LABELS = {
    "delay": "delay margin",
    "gain_up": "steer gain margin upward",
    "gain_down": "steer gain margin downward",
    "inside": "robustness within +/-20 %",
}
HEAD = ("", "delay", "gain down", "gain up", "fails in +/-20 %", "beyond", "steering rate", "reversals")
NO_VALUE = "-"


def margin_text(margins: Mapping[str, Any], tuned: str) -> str:
    """The end of a sentence, such as 'but with less delay margin than as_shipped: 60 ms against 110 ms'.

    It names failures of the winner within +/-20 %; '' where there are no margins.
    """
    if margins["reason"]:
        return ""
    smaller, reference, winner = margins["less"], margins["against"], margins["vectors"][tuned]
    if smaller:
        parts = [f"less {MARGIN_LABELS[entry['what']]} than {reference}: {_pair_text(entry)}" for entry in smaller]
        text = "but with " + ", ".join(parts)
    elif reference is None:
        text = f"delay margin {_delay_text(winner['delay'])}; no manual vector drives all scenarios without a re-plan"
    else:
        delay = _delay_text(margins["vectors"][reference]["delay"])
        text = f"delay margin {_delay_text(winner['delay'])} against {delay} of {reference}"
    if winner["inside"]["failed"] and "inside" not in [entry["what"] for entry in smaller]:
        text += f"; it FAILS {_rate_text(winner['inside'])} drives within +/-20 %"
    return text


def margin_table(margins: Mapping[str, Any], tuned: str) -> list[str]:
    """One line a vector, '<' beside smaller margins than manual; then failures of the winner and missing groups."""
    vectors, smaller = margins["vectors"], {entry["what"] for entry in margins["less"]}
    rows = [HEAD, *(_row(name, vector, smaller if name == tuned else set()) for name, vector in vectors.items())]
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEAD))]
    lines = ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows]
    if smaller:
        lines.append(f"< marks margins of {tuned} that are smaller than those of {margins['against']}")
    lines += _list_failures(tuned, vectors[tuned]["points"])
    lines += [f"{group}: not driven, {reason}" for group, reason in margins["missing"].items()]
    if margins["reason"]:
        lines.append(f"no margins: {margins['reason']}")
    return lines


def _list_failures(tuned: str, points: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line for each scenario and outcome, with the cars that failed."""
    cars: dict[tuple[str, str], list[str]] = {}
    for point in points:
        for key in point["failures"].items():
            cars.setdefault(key, []).append(point["what"])
    return [
        f"{tuned} fails in {scenario} ({outcome}) with {'; '.join(names)}"
        for (scenario, outcome), names in sorted(cars.items())
    ]


def _row(name: str, vector: Mapping[str, Any], smaller: set[str]) -> tuple[str, ...]:
    cells = {
        "delay": _delay_text(vector["delay"]),
        "gain_down": _gain_text(vector["gain_down"]),
        "gain_up": _gain_text(vector["gain_up"]),
        "inside": _rate_text(vector["inside"]),
    }
    marked = [text + (" <" if what in smaller else "") for what, text in cells.items()]
    steering = vector["steering"]
    rate = f"{steering['rate_rms_radps']:.3f} rad/s" if steering else NO_VALUE
    reversals = f"{steering['reversals_per_s']:.2f} /s" if steering else NO_VALUE
    return (name, *marked, _rate_text(vector["beyond"], share=True), rate, reversals)


def _pair_text(entry: Mapping[str, Any]) -> str:
    if entry["what"] == "inside":
        return f"{_rate_text(entry['tuned'])} drives fail against {_rate_text(entry['manual'])}"
    text = _delay_text if entry["what"] == "delay" else _gain_text
    return f"{text(entry['tuned'])} against {text(entry['manual'])}"


def _delay_text(margin: Mapping[str, Any] | None) -> str:
    if margin is None:
        return NO_VALUE
    return f"{'>= ' if margin['at_least'] else ''}{1e3 * margin['value']:.0f} ms"


def _gain_text(margin: Mapping[str, Any] | None) -> str:
    """The first factor with a re-plan or a failure."""
    if margin is None:
        return NO_VALUE
    sign = "<= " if margin["value"] < 1.0 else ">= "
    return f"{sign if margin['at_least'] else ''}{margin['value']:.2f}"


def _rate_text(rate: Mapping[str, Any] | None, *, share: bool = False) -> str:
    if rate is None or not rate["drives"]:
        return NO_VALUE
    return f"{rate['failed']} of {rate['drives']}" + (f" ({100.0 * rate['share']:.0f} %)" if share else "")
