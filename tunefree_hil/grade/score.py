"""Score of a drive, and the paper's eq. 7 over several scenarios. Lower is better.

A scenario's score is the weighted mean of its metrics plus 1.0 per re-plan; a failed drive scores 10.0, which is also
the cap (docs/reference/grading.md). Scenarios are weighted by their planned number of samples, so that a drive that
ends early does not count less.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import VehicleSpec, WeightsSpec
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.memo import CourseCache
from tunefree_hil.grade.metrics import (
    METRICS,
    MetricEvaluator,
    MetricSamples,
    MetricScales,
    is_planned,
    metric_formula,
    samples_from_plan,
    samples_from_recording,
)
from tunefree_hil.grade.original_reference import samples_against_original
from tunefree_hil.grade.oscillation.detection import find_oscillations, oscillation_metrics, with_references
from tunefree_hil.grade.oscillation.report import OscillationReport, finding_as_data
from tunefree_hil.grade.requirements.measure import RequirementValues, measure_requirements

FINISHED = "finished"
DIVERGED = "diverged"
LEFT_LANE = "left_lane"
CONTROL_ERRORS = ("control_error", "controller_own", "no_solution")  # errors caused by the controller
GRADED_ENDS = ("", DIVERGED, LEFT_LANE, *CONTROL_ERRORS)  # ends caused by the parameters; all others by the bench
PEDAL_ALTERNATION = "pedal_alternation"
SCORE_METRICS = (*METRICS, PEDAL_ALTERNATION)  # metrics that weights may name
MAX_MISSING_TICKS = 10  # a recording that lacks up to so many planned rows counts as complete


class GradeVehicle(NamedTuple):
    """Vehicle constants that grading needs."""

    wheelbase_m: float
    rear_axle_m: float  # rear axle (INS point) to centre of mass
    steer_rad: float
    steer_rate_radps: float
    rest_pedal_frac: float = 0.0  # duty of a released pedal


class ScenarioGrade(NamedTuple):
    """Grade of one drive. metrics: every metric of SCORE_METRICS, None where not available.

    outcome: 'finished', or the name of what ended the drive. dropped: weighted metrics that are None.
    oscillation: of it only the pedals' alternation is a part of the score. requirements: no part of the score; a value
    of every requirement, None where not available.
    """

    scenario: str
    score: float
    metrics: dict[str, float | None]
    replans: int
    outcome: str
    planned_samples: int
    dropped: tuple[str, ...] = ()
    oscillation: OscillationReport = OscillationReport()
    requirements: RequirementValues = MappingProxyType({})

    def as_data(self) -> dict[str, Any]:
        """Plain data for JSON. The worst oscillation is in it where it is beyond its limit."""
        data, worst = self._asdict(), self.oscillation.worst
        data["requirements"] = dict(self.requirements)
        data["oscillation"] = None if worst is None or worst.ratio <= 1.0 else finding_as_data(worst)
        return data


class ScenarioEnd(NamedTuple):
    """Which scenario was driven, and the name of the error that ended its drive, '' for none.

    Any error scores failure_score, so errors of the bench (not in GRADED_ENDS) must not be graded.
    """

    scenario: str = ""
    error: str = ""


NAMELESS_END = ScenarioEnd()  # of a drive that came to its end


def grade_vehicle_from_spec(spec: VehicleSpec) -> GradeVehicle:
    """Vehicle constants from vehicle.toml. Raises InputError that names a missing one."""
    nominal = spec.nominal
    if nominal.wheelbase_m is None:
        raise InputError(
            "missing; it is needed to normalise the lateral metrics",
            code="missing_nominal",
            file=f"{spec.folder}/vehicle.toml",
            key="nominal.wheelbase_m",
            hint="add the wheelbase in metres",
        )
    front_axle_m = nominal.front_axle_m if nominal.front_axle_m is not None else 0.5 * nominal.wheelbase_m
    return GradeVehicle(
        nominal.wheelbase_m,
        nominal.wheelbase_m - front_axle_m,
        spec.limits.steer_rad,
        spec.limits.steer_rate_radps,
        nominal.rest_pedal_frac,
    )


def grade_drive(
    recording: Recording,
    course: Course,
    weights: WeightsSpec,
    vehicle: GradeVehicle,
    end: ScenarioEnd = NAMELESS_END,
) -> ScenarioGrade:
    """Grade one drive of `course`.

    Leaving the lane and diverging are also detected from the columns. A metric of samples that the course does not
    plan (harsh ones) is None even where a re-plan's blend produced some: the same weights count in every drive of a
    scenario.

    Raises:
        InputError: The recording ends early without an error, or no metric is available.
    """
    original = samples_against_original(recording, course, vehicle.rear_axle_m)
    samples = original if weights.against == "original" else samples_from_recording(recording)
    scales = MetricScales(vehicle.wheelbase_m, vehicle.steer_rad, vehicle.steer_rate_radps, recording.dt_s)
    sharing, planned = MetricEvaluator(samples, scales), planned_metrics(course)
    metrics = {
        name: sharing.value(metric_formula(name, as_published=weights.as_published)) if name in planned else None
        for name in METRICS
    }
    columns = with_references(recording.columns, original)
    oscillation = find_oscillations(columns, recording.dt_s, rest_pedal_frac=vehicle.rest_pedal_frac)
    ratios = oscillation_metrics(oscillation, columns, recording.dt_s)
    metrics[PEDAL_ALTERNATION] = ratios.get(PEDAL_ALTERNATION)
    outcome = end.error or judge_outcome(original, weights)
    replans = _count_replans(recording)
    dropped = tuple(name for name, weight in weights.metrics.items() if weight > 0.0 and metrics[name] is None)
    if outcome != FINISHED:
        score = weights.failure_score
    else:
        _require_complete(recording, course, end.scenario)
        score = min(weighted_mean(metrics, weights) + weights.replan_penalty * replans, weights.failure_score)
    requirements = measure_requirements(recording, course, original, oscillation, replans)
    return ScenarioGrade(
        end.scenario, score, metrics, replans, outcome, course.ticks, dropped, oscillation, requirements
    )


def planned_metrics(course: Course) -> frozenset[str]:
    """The metrics of METRICS whose samples the course plans."""
    return _planned_metrics_cache(course)


def _find_planned_metrics(course: Course) -> frozenset[str]:
    plan = samples_from_plan(course)
    return frozenset(name for name in METRICS if is_planned(name, plan))


_planned_metrics_cache = CourseCache(_find_planned_metrics)


def judge_outcome(original: MetricSamples, weights: WeightsSpec) -> str:
    """Outcome by the errors against the original path: 'finished', 'diverged' or 'left_lane', whichever is first.

    Diverged: an error is not finite after the first finite one, or |heading error| is above its limit.
    """
    lateral, heading = original.lateral_error_m, original.heading_error_rad
    if lateral is None or heading is None:
        return FINISHED
    is_diverged_row = ~np.isfinite(lateral + heading)
    is_diverged_row[: int(np.argmin(is_diverged_row))] = False  # before the first fix
    with np.errstate(invalid="ignore"):
        diverged = _first_true(is_diverged_row | (np.abs(heading) > weights.divergence_heading_rad))
        lane_left = _first_true(np.abs(lateral) > weights.lane_half_width_m)
    if diverged == lane_left:
        return FINISHED if diverged == len(lateral) else DIVERGED
    return DIVERGED if diverged < lane_left else LEFT_LANE


def weighted_mean(metrics: dict[str, float | None], weights: WeightsSpec) -> float:
    """Weighted mean of the metrics, renormalised over the available ones (the inner sum of eq. 7)."""
    total = share = 0.0
    for name, weight in weights.metrics.items():
        value = metrics[name]
        if value is not None and weight > 0.0:
            total += weight * counted_value(value, weights)
            share += weight
    if share == 0.0:
        raise InputError(
            "none of the weighted metrics can be computed from this recording",
            code="nothing_to_grade",
            file=weights.path,
            hint="does the vehicle send INS frames, and does the log contain at least 5 ticks of them?",
        )
    return total / share


def counted_value(value: float, weights: WeightsSpec) -> float:
    """The part of a metric's value that the score counts."""
    return min(value, weights.largest_value) if weights.largest_value > 0.0 else value


def combine_scores(grades: Sequence[ScenarioGrade]) -> float:
    """Eq. 7: mean of the scenarios' scores, weighted by their planned samples m_j. Raises ValueError for none."""
    planned = sum(grade.planned_samples for grade in grades)
    if planned <= 0:
        raise ValueError("no scenario to combine")
    return sum(grade.score * grade.planned_samples for grade in grades) / planned


def _first_true(flags: np.ndarray) -> int:
    """Index of the first True, or the length."""
    return int(np.argmax(flags)) if flags.any() else len(flags)


def _count_replans(recording: Recording) -> int:
    replan = recording.get("replan")
    return 0 if replan is None else int(np.count_nonzero(replan > 0.5))


def _require_complete(recording: Recording, course: Course, scenario: str) -> None:
    if recording.ticks < course.ticks - MAX_MISSING_TICKS:
        raise InputError(
            f"{scenario!r}: {recording.ticks} of {course.ticks} ticks were recorded, without an error",
            code="recording_short",
            hint="the drive was interrupted; drive it again",
        )
