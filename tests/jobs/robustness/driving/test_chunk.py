"""Rows of a chunk: what is kept of a grade, and of a drive that the bench ended."""

from __future__ import annotations

import math
from pathlib import Path

from tests.jobs.robustness.made_sweep import StandIn, grade, plan_of
from tunefree_hil.bench.batch import Job
from tunefree_hil.config.tuning.require_schema import REQUIREMENTS
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.robustness.driving.chunk import drive_chunk
from tunefree_hil.jobs.robustness.plan import SweepDrive


def test_a_row_is_a_drive_of_the_plan_with_its_grade(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 3)

    def answer(job: Job) -> ScenarioGrade | str:
        if job.seed is None and job.values["station.kp"] == 0.5:
            return "peer_gone"
        if job.seed is None:
            return grade(job, "left_lane", lateral_error_peak_m=math.inf, speed_error_peak_mps=0.5)
        return grade(job, replans=2.0)

    chunk = drive_chunk(StandIn(answer), plan, 0)
    assert [SweepDrive(*row[:3]) for row in chunk.rows] == plan.list_drives(0) and chunk.number == 0
    first, second, third, _ = chunk.rows[:4]
    assert (first.outcome, first.score, first.ticks) == ("left_lane", 10.0, 100)
    assert dict(zip(REQUIREMENTS, first.values, strict=True))["lateral_error_peak_m"] is None
    assert dict(zip(REQUIREMENTS, first.values, strict=True))["speed_error_peak_mps"] == 0.5
    assert (second.outcome, second.score, set(second.values)) == ("peer_gone", None, {None})
    assert (third.outcome, third.replans, third.car) == ("finished", 2, plan.roads[0].other_car)


def test_chunks_share_all_roads_among_them(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 130)
    assert plan.roads_per_chunk == 60 and plan.chunks == 3
    assert [len(plan.list_drives(number)) for number in range(3)] == [240, 240, 40]
