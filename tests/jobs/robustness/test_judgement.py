"""One drive: passed, a requirement missed, stability lost, and which cause is named."""

from __future__ import annotations

import math

import pytest

from tunefree_hil.config.tuning.require_schema import REQUIREMENTS
from tunefree_hil.jobs.robustness.driving.chunk import DriveRow
from tunefree_hil.jobs.robustness.judgement import DriveState, judge_row

LIMITS = {"lateral_error_peak_m": 0.5, "steer_oscillation_rad": 0.05, "pedal_alternation_per_s": 0.5, "replans": 0.0}
PASSED, MISSED, LOST = DriveState


def row(outcome: str = "finished", score: float | None = 0.2, **values: float | None) -> DriveRow:
    known: dict[str, float | None] = {**dict.fromkeys(REQUIREMENTS, 0.0), **values}
    replans = int(known["replans"] or 0)
    return DriveRow(3, 0, 0, outcome, score, replans, 100, tuple(known[name] for name in REQUIREMENTS))


@pytest.mark.parametrize(
    ("drive", "state", "cause", "binding"),
    [
        (row(), PASSED, "", "lateral_error_peak_m"),
        (row(lateral_error_peak_m=0.5), PASSED, "", "lateral_error_peak_m"),
        (row(lateral_error_peak_m=0.51), MISSED, "requirement", "lateral_error_peak_m"),
        (row(accel_jerk_peak_mps3=99.0), PASSED, "", "lateral_error_peak_m"),  # not required here
        (row(steer_oscillation_rad=0.06), LOST, "oscillation", "steer_oscillation_rad"),
        (row(steer_oscillation_rad=0.06, lateral_error_peak_m=5.0), LOST, "oscillation", "steer_oscillation_rad"),
        (row(pedal_alternation_per_s=0.7), LOST, "oscillation", "pedal_alternation_per_s"),
        (row(replans=1.0), LOST, "replan", "replans"),
        (row(replans=1.0, steer_oscillation_rad=9.0), LOST, "replan", "steer_oscillation_rad"),
        (row("left_lane"), LOST, "left_lane", None),
        (row("diverged", lateral_error_peak_m=None), LOST, "diverged", None),
        (row("missing_report", None), LOST, "missing_report", None),
    ],
)
def test_a_drive_has_one_state_and_its_first_cause(
    drive: DriveRow, state: DriveState, cause: str, binding: str | None
) -> None:
    judged = judge_row(drive, LIMITS, "road")
    assert (judged.state, judged.cause) == (state, cause)
    if binding is not None:
        assert judged.binding is not None and (judged.binding.name, judged.binding.road) == (binding, "road")


def test_a_drive_that_was_not_finished_is_worse_than_any_that_was() -> None:
    ended, shaken = judge_row(row("left_lane"), LIMITS), judge_row(row(steer_oscillation_rad=9.0), LIMITS)
    assert ended.ratio == math.inf > shaken.ratio == pytest.approx(180.0)


def test_a_count_of_0_is_not_near_its_limit() -> None:
    near = judge_row(row(lateral_error_peak_m=0.4), LIMITS)
    assert near.binding is not None and near.binding.name == "lateral_error_peak_m" and near.ratio == 0.8
    assert judge_row(row(), LIMITS).ratio == 0.0


def test_a_replan_counts_as_far_as_it_is_limited() -> None:
    assert judge_row(row(replans=2.0), {**LIMITS, "replans": 2.0}).state is PASSED
    assert judge_row(row(replans=2.0), {}).state is PASSED


def test_states_are_ordered() -> None:
    assert PASSED < MISSED < LOST
