"""From metrics to one number: a scenario's grade, and the paper's eq. 7 over the scenarios. Lower is better.

A scenario's score is the weighted mean of its metrics plus 1.0 per re-plan; a failed drive scores 10.0, and no drive
scores above that (design D11). Over scenarios it is weighted by the *planned* number of samples, so that a drive that
ends early does not count less.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import VehicleSpec, WeightsSpec
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.memo import Kept
from tunefree_hil.grade.metrics import (
    METRICS,
    Samples,
    Scales,
    Sharing,
    is_planned,
    row_of,
    samples_of,
    samples_of_plan,
)
from tunefree_hil.grade.original_reference import samples_against_original

FINISHED = "finished"
DIVERGED = "diverged"
LEFT_LANE = "left_lane"
CONTROL_ERRORS = ("control_error", "controller_own")  # names of the errors that a controller answers for
GRADED = ("", DIVERGED, LEFT_LANE, *CONTROL_ERRORS)  # ends that the parameters answer for; the rest is the bench's
MISSING_TICKS = 10  # a recording may lack so many of the planned rows and still count as driven to its end


class GradeVehicle(NamedTuple):
    """The vehicle's numbers that grading needs."""

    wheelbase_m: float
    rear_axle_m: float  # rear axle (INS point) to centre of mass
    steer_rad: float
    steer_rate_radps: float
    rest_pedal_frac: float = 0.0  # duty of a pedal that nobody touches


class ScenarioGrade(NamedTuple):
    """How one drive was. `metrics` holds every metric of METRICS, None where it could not be had.

    outcome: 'finished', or the name of what ended the drive. dropped: weighted metrics that were None.
    """

    scenario: str
    score: float
    metrics: dict[str, float | None]
    replans: int
    outcome: str
    planned_samples: int
    dropped: tuple[str, ...] = ()


def vehicle_of(spec: VehicleSpec) -> GradeVehicle:
    """The numbers that grading needs of vehicle.toml. Raises InputError that names a missing one."""
    nominal = spec.nominal
    if nominal.wheelbase_m is None:
        raise InputError(
            "needed to normalise the lateral metrics, and missing",
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


def grade(
    recording: Recording,
    course: Course,
    weights: WeightsSpec,
    vehicle: GradeVehicle,
    *,
    scenario: str = "",
    error: str = "",
) -> ScenarioGrade:
    """Grade one drive of `course`.

    error: name of the error that ended the drive, '' for none; any error scores failure_score, so errors of the bench
    (a lost process, somebody's stop: none of GRADED) are not to be graded. Leaving the lane and diverging are also
    found in the columns themselves. A metric of samples that the course does not plan (harsh ones) is None whatever a
    re-plan's blend made of the reference: the same weights count in every drive of a scenario (interfaces 6). Raises
    InputError for a recording that ends early without an error, or in which nothing can be graded.
    """
    original = samples_against_original(recording, course, vehicle.rear_axle_m)
    samples = original if weights.against == "original" else samples_of(recording)
    scales = Scales(vehicle.wheelbase_m, vehicle.steer_rad, vehicle.steer_rate_radps, recording.dt_s)
    sharing, planned = Sharing(samples, scales), planned_metrics(course)
    metrics = {
        name: sharing.metric(row_of(name, as_published=weights.as_published)) if name in planned else None
        for name in METRICS
    }
    outcome = error or judge(original, weights)
    replans = _replans(recording)
    dropped = tuple(name for name, weight in weights.metrics.items() if weight > 0.0 and metrics[name] is None)
    if outcome != FINISHED:
        score = weights.failure_score
    else:
        _require_whole(recording, course, scenario)
        score = min(weighted_mean(metrics, weights) + weights.replan_penalty * replans, weights.failure_score)
    return ScenarioGrade(scenario, score, metrics, replans, outcome, course.ticks, dropped)


def planned_metrics(course: Course) -> frozenset[str]:
    """The metrics of METRICS whose samples the course plans (is_planned)."""
    return _planned(course)


def _plan(course: Course) -> frozenset[str]:
    plan = samples_of_plan(course)
    return frozenset(name for name in METRICS if is_planned(name, plan))


_planned = Kept(_plan)


def judge(original: Samples, weights: WeightsSpec) -> str:
    """'finished', or what the errors against the original path show first: 'diverged' or 'left_lane'.

    Diverged: an error is not finite after the first one that was, or |heading error| is above its limit.
    """
    lateral, heading = original.lateral_error_m, original.heading_error_rad
    if lateral is None or heading is None:
        return FINISHED
    lost = ~np.isfinite(lateral + heading)
    lost[: int(np.argmin(lost))] = False  # nothing heard yet
    with np.errstate(invalid="ignore"):
        diverged = _first(lost | (np.abs(heading) > weights.divergence_heading_rad))
        left = _first(np.abs(lateral) > weights.lane_half_width_m)
    if diverged == left:
        return FINISHED if diverged == len(lateral) else DIVERGED
    return DIVERGED if diverged < left else LEFT_LANE


def weighted_mean(metrics: dict[str, float | None], weights: WeightsSpec) -> float:
    """Mean of the metrics by their weights, renormalised over those that could be had (the inner sum of eq. 7)."""
    total = share = 0.0
    for name, weight in weights.metrics.items():
        value = metrics[name]
        if value is not None and weight > 0.0:
            total += weight * value
            share += weight
    if share == 0.0:
        raise InputError(
            "not one of the weighted metrics can be computed from this recording",
            code="nothing_to_grade",
            file=weights.path,
            hint="does the vehicle have INS frames, and does the log hold at least 5 ticks of them?",
        )
    return total / share


def combine(grades: Sequence[ScenarioGrade]) -> float:
    """Eq. 7: mean of the scenarios' scores, weighted by their planned samples m_j. ValueError for none."""
    planned = sum(grade.planned_samples for grade in grades)
    if planned <= 0:
        raise ValueError("no scenario to combine")
    return sum(grade.score * grade.planned_samples for grade in grades) / planned


def _first(flags: np.ndarray) -> int:
    """Index of the first True, or the length."""
    return int(np.argmax(flags)) if flags.any() else len(flags)


def _replans(recording: Recording) -> int:
    replan = recording.get("replan")
    return 0 if replan is None else int(np.count_nonzero(replan > 0.5))


def _require_whole(recording: Recording, course: Course, scenario: str) -> None:
    if recording.ticks < course.ticks - MISSING_TICKS:
        raise InputError(
            f"{scenario!r} was recorded for {recording.ticks} ticks of {course.ticks} and no error says why",
            code="recording_short",
            hint="the drive was interrupted: drive it again",
        )
