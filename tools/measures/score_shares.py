"""What is a score made of? Shares of its metrics and aspects for calm and for shaking sets, and what no gains change.

Only drives count that start beside their road and end without a re-plan, because these have every metric. The rule that
the weights `default` follow is applied to what is measured, too (`weights_by_rule`): a principle, not a taste.
"""

from __future__ import annotations

import csv
import dataclasses
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean, median
from typing import Any, NamedTuple

from msgspec.structs import replace

from tools.measures._summary import rounded
from tools.measures.oscillation import random_sets
from tools.measures.parity import bench_files
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.config.load import load_weights
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.control.parameters import BASELINES, study_values
from tunefree_hil.grade.score import FINISHED, ScenarioGrade, counted_value
from tunefree_hil.grade.table import COMFORT, EFFORT, PERFORMANCE, SAFETY, TABLE
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.roads.sets import road_set

VALUE = "largest share of one metric in the score of a calm manual set, percent"
PREVIEW_PARTS = {"lateral": "lqr_preview", "longitudinal": "pid_preview", "inner": "mrac_robust"}
SHIPPED = ("as_shipped", "mrac_on")
RULE_BASED, PREVIEW, SHAKING, RANDOM = "rule_based", "preview", "shaking", "random"
CALM = (*SHIPPED, PREVIEW)  # candidates
SHAKING_RANDOM, LEAST, SCORE = "shaking random sets", "least of any set", "score"  # columns and row of the table
# What the textbook rules gave before they minded the pedals' dead time: the shaking sets, by vehicle.
HASTY: dict[str, dict[str, float]] = tomllib.loads((Path(__file__).parent / "hasty_gains.toml").read_text("utf-8"))
MIN_DRIVES = 5  # a set with fewer complete drives has no shares
START_METRIC = "start_overshoot"  # it exists where a drive starts beside its road

# The rule of `default`: an aspect's share of a calm score is the share of its metrics among those which Apollo
# publishes (18, 5, 6 and 6); within an aspect every group has the same share, within a group every metric. Heading is
# not weighed: with the vehicle on its road it is the side-slip, and gains that lower it raise the lateral error.
ASPECT_METRICS = {
    aspect: sum(row.aspect == aspect and not row.ours for row in TABLE.values())
    for aspect in (PERFORMANCE, SAFETY, COMFORT, EFFORT)
}
GROUPS: dict[str, tuple[tuple[str, ...], ...]] = {
    PERFORMANCE: (
        ("lateral_rms_after_start",),
        ("station_rms_after_start",),
        ("speed_rms_after_start",),
        ("start_overshoot", "start_settling"),
    ),
    SAFETY: (("lateral_peak_after_start",), ("station_peak_after_start",), ("speed_peak_after_start",)),
    COMFORT: (("lateral_jerk_rms",), ("longitudinal_jerk_rms",)),
    EFFORT: (("steer_rate_rms",), ("pedal_rate_rms",)),
}
# Zero for a calm set, so it has no share there: at its limit it costs as much as a calm set's whole effort.
AT_LIMIT = "pedal_alternation"
WEIGHTS_SUM = 100.0


class DrivePlan(NamedTuple):
    """What is driven: number of made roads and of random sets, seed of both, name of the model ('': verify_model)."""

    roads: int
    sets: int
    seed: int
    model: str


class DrivenSet(NamedTuple):
    """A gain set on the roads of a vehicle. grades: of complete drives, by road. n_driven: number of all drives."""

    vehicle: str
    name: str
    grades: dict[str, ScenarioGrade]
    n_driven: int

    @property
    def is_named(self) -> bool:
        """Whether it is no random set."""
        return not self.name.startswith(RANDOM)

    @property
    def is_calm(self) -> bool:
        """Whether the worst oscillation of the median drive is within its limit."""
        return median(grade.oscillation.worst_ratio for grade in self.grades.values()) <= 1.0

    @property
    def is_manual_calm(self) -> bool:
        """Whether it is one of the manual sets that the rule is made for, and calm on this vehicle."""
        return self.name in CALM and self.is_calm


def measure(
    roads: int = 60, sets: int = 30, seed: int = 4711, weights: str = "default", benches: str = "", model: str = "",
    table: str = "",
) -> dict[str, Any]:  # fmt: skip
    """Manual sets and `sets` random ones with both kinds of controller on `roads` made roads of each vehicle.

    weights: name or path. benches: files with commas between, '' for one a vehicle. model: '' is the one that the bench
    verifies with. table: a CSV file to write, '' for none.
    """
    driven: list[DrivenSet] = []
    for path in bench_files(benches):
        bench = load(path)
        spec = load_weights(weights, bench.spec.path)
        driven += _drive_bench(dataclasses.replace(bench, weights=spec), DrivePlan(roads, sets, seed, model))
    complete = [one for one in driven if len(one.grades) >= MIN_DRIVES]
    calm = [one for one in complete if one.is_manual_calm]
    columns = _columns(complete, spec)
    rows = share_rows(columns, spec)
    if table:
        _write_table(Path(table), rows)
    largest = [max(columns[f"{one.vehicle} {one.name}"][name] for name in spec.metrics) for one in calm]
    detail = {
        "shares": rows,
        "calm": [f"{one.vehicle} {one.name}" for one in calm],
        "drives": {f"{one.vehicle} {one.name}": [len(one.grades), one.n_driven] for one in driven if one.is_named},
        "weights_by_rule": weights_by_rule(calm),
    }
    low, high = min(largest), max(largest)
    return {"value": high, "unit": "%", "n": len(largest), "low": low, "high": high, "detail": rounded(detail)}


def _drive_bench(bench: Bench, plan: DrivePlan) -> Iterator[DrivenSet]:
    """All sets of one vehicle, with the plain controller and with preview."""
    with_preview = replace(bench.spec.controller, **PREVIEW_PARTS)
    ahead = dataclasses.replace(bench, spec=replace(bench.spec, controller=with_preview))
    scenarios = road_set(bench.vehicle, "families", plan.roads, plan.seed)
    plain = {name: BASELINES[name] for name in SHIPPED}
    plain[RULE_BASED] = compute_baseline_vectors(bench)[RULE_BASED]
    if bench.vehicle.name in HASTY:
        plain[SHAKING] = {**study_values(), "mrac.p": 1e-4, **HASTY[bench.vehicle.name]}
    for one, named in ((bench, plain), (ahead, {PREVIEW: BASELINES[SHIPPED[0]]})):
        drawn = random_sets(plan.sets, f"score shares {plan.seed} {bench.vehicle.name}")
        vectors = named | {f"{RANDOM} {number}": values for number, values in enumerate(drawn)}
        with Batch(one, plan.model or bench.spec.verify_model) as batch:
            for name, values in vectors.items():
                full = parameters_of(one, values)
                driven = batch.drive([Job(full, scenario) for scenario in scenarios])
                grades = {scenario.name: drive.grade for scenario, drive in zip(scenarios, driven, strict=True)}
                complete = {road: grade for road, grade in grades.items() if grade is not None and is_complete(grade)}
                yield DrivenSet(bench.vehicle.name, name, complete, len(driven))


def is_complete(grade: ScenarioGrade) -> bool:
    """Whether a drive started beside its road and ended without a re-plan."""
    return grade.outcome == FINISHED and grade.replans == 0 and grade.metrics[START_METRIC] is not None


def mean_terms(grades: Iterable[ScenarioGrade], weights: WeightsSpec) -> dict[str, float]:
    """Metric -> its part of the mean score of these drives; the parts add up to the score."""
    terms = dict.fromkeys(weights.metrics, 0.0)
    drives = list(grades)
    for grade in drives:
        known = {name: value for name in weights.metrics if (value := grade.metrics[name]) is not None}
        total = sum(weights.metrics[name] for name in known)
        for name, value in known.items():
            terms[name] += weights.metrics[name] / total * counted_value(value, weights) / len(drives)
    return terms


def least_terms(sets: Sequence[DrivenSet], weights: WeightsSpec) -> dict[str, float]:
    """As mean_terms, of the least value that any of these sets has on each road: no gains of theirs go below."""
    roads: dict[str, list[ScenarioGrade]] = {}
    for one in sets:
        for road, grade in one.grades.items():
            roads.setdefault(road, []).append(grade)
    lowest = [
        grades[0]._replace(metrics={name: _least(grade.metrics[name] for grade in grades) for name in weights.metrics})
        for grades in roads.values()
    ]
    return mean_terms(lowest, weights)


def _least(values: Iterable[float | None]) -> float | None:
    return min((value for value in values if value is not None), default=None)


def _columns(sets: Sequence[DrivenSet], weights: WeightsSpec) -> dict[str, dict[str, float]]:
    """Column of the table -> its parts in percent of its own score; least: in percent of the calm sets' mean score."""
    columns: dict[str, dict[str, float]] = {}
    for vehicle in dict.fromkeys(one.vehicle for one in sets):
        own = [one for one in sets if one.vehicle == vehicle]
        terms = {one.name: mean_terms(one.grades.values(), weights) for one in own if one.is_named}
        shaking = [grade for one in own if not one.is_named and not one.is_calm for grade in one.grades.values()]
        terms |= {SHAKING_RANDOM: mean_terms(shaking, weights)} if shaking else {}
        scores = {name: sum(parts.values()) for name, parts in terms.items()}
        calm = [scores[one.name] for one in own if one.is_manual_calm]
        if calm:
            terms[LEAST], scores[LEAST] = least_terms(own, weights), fmean(calm)
        columns |= {
            f"{vehicle} {name}": {SCORE: sum(parts.values()), **_shares(parts, scores[name])}
            for name, parts in terms.items()
        }
    return columns


def _shares(parts: Mapping[str, float], score: float) -> dict[str, float]:
    return {name: 100.0 * part / score for name, part in parts.items()}


def share_rows(columns: Mapping[str, Mapping[str, float]], weights: WeightsSpec) -> list[dict[str, Any]]:
    """Rows of the table: an aspect's sum, then its metrics, then the score."""
    rows: list[dict[str, Any]] = []
    for aspect in dict.fromkeys(row.aspect for row in TABLE.values()):
        names = [name for name in TABLE if TABLE[name].aspect == aspect and weights.metrics.get(name, 0.0) > 0.0]
        if not names:
            continue
        sums = {key: sum(column[name] for name in names) for key, column in columns.items()}
        rows.append({"percent": f"**{aspect}**", "weight": "", **sums})
        for name in names:
            values = {key: column[name] for key, column in columns.items()}
            rows.append({"percent": f"`{name}`", "weight": weights.metrics[name], **values})
    rows.append({"percent": SCORE, "weight": "", **{key: column[SCORE] for key, column in columns.items()}})
    return rows


def _write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(rows[0])
        for row in rows:
            digits = 3 if row["percent"] == SCORE else 1
            cells = {key: f"{cell:.{digits}f}" for key, cell in row.items() if key not in ("percent", "weight")}
            writer.writerow({**row, **cells}.values())


def weights_by_rule(calm: Sequence[DrivenSet]) -> dict[str, float]:
    """Weights that give every metric the share of ASPECT_METRICS and GROUPS in a score of the calm sets' medians."""
    published = sum(ASPECT_METRICS.values())
    raw: dict[str, float] = {}
    for aspect, groups in GROUPS.items():
        for group in groups:
            share = ASPECT_METRICS[aspect] / published / len(groups) / len(group)
            raw |= {name: share / _median_value(calm, name) for name in group}
    raw[AT_LIMIT] = ASPECT_METRICS[EFFORT] / published
    total = sum(raw.values())
    return {name: WEIGHTS_SUM * weight / total for name, weight in raw.items()}


def _median_value(calm: Sequence[DrivenSet], name: str) -> float:
    return median(fmean(grade.metrics[name] or 0.0 for grade in one.grades.values()) for one in calm)
