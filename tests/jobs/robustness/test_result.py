"""What a sweep comes to: roads by their worst drive, undrivable ones apart, the worst drives, and the texts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.jobs.robustness.made_sweep import StandIn, grade, plan_of
from tunefree_hil.bench.batch import Job
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.robustness import result as module
from tunefree_hil.jobs.robustness.driving.chunk import drive_chunk
from tunefree_hil.jobs.robustness.judgement import DriveState
from tunefree_hil.jobs.robustness.physical_limits import PhysicalExcess, PhysicalLimit
from tunefree_hil.jobs.robustness.plan import SweepPlan, family_of
from tunefree_hil.jobs.robustness.result import (
    SweepResult,
    SweepVerdict,
    decide_verdict,
    find_worst_drives,
    judge_sweep,
    sweep_data,
)
from tunefree_hil.jobs.robustness.text import family_table, set_table, share_text, sweep_sentence

LIMITS = {"lateral_error_peak_m": 0.5, "steer_oscillation_rad": 0.05, "replans": 0.0}
WINNER = 0.25  # station.kp of the first set


def judged(plan: SweepPlan, answer: Callable[[Job], ScenarioGrade]) -> SweepResult:
    driver = StandIn(answer)
    rows = [row for number in range(plan.chunks) for row in drive_chunk(driver, plan, number).rows]
    return judge_sweep(plan, rows, LIMITS)


def sentence(plan: SweepPlan, result: SweepResult, allowed: int = 0) -> str:
    return sweep_sentence(plan, result, find_worst_drives(plan, result, 4), allowed)


def test_a_road_counts_once_with_its_worst_drive(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 30)
    first, second, third = (road.spec.name for road in plan.roads[:3])

    def answer(job: Job) -> ScenarioGrade:
        name, is_nominal = job.scenario.name, job.seed is None
        if job.values["station.kp"] != WINNER:
            return grade(job, lateral_error_peak_m=0.6 if name == third else 0.1)
        if name == first:
            return grade(job, "left_lane") if is_nominal else grade(job, lateral_error_peak_m=0.9)
        if name == second:
            return grade(job) if is_nominal else grade(job, lateral_error_peak_m=0.7)
        return grade(job)

    result = judged(plan, answer)
    winner = result.winner
    assert (winner.roads.failed, winner.roads.n) == (2, 30)
    assert (winner.count(DriveState.STABILITY_LOST), winner.count(DriveState.REQUIREMENT_MISSED)) == (1, 1)
    assert (winner.nominal.failed, winner.other_cars.failed) == (1, 2) and winner.nominal.n == 30
    assert winner.causes == {"left_lane": 1, "requirement": 2}
    assert result.best_manual == "b" and result.sets["b"].roads.failed == 1 and result.hopeless == ()
    worst = find_worst_drives(plan, result, 4)
    assert [(drive.road, drive.car) for drive in worst] == [(0, 0), (1, plan.roads[1].other_car)]
    data = sweep_data(plan, result)
    families = data["sets"]["a"]["families"]
    assert sum(one["failed"] for one in families.values()) == 2 and sum(one["n"] for one in families.values()) == 30
    assert families[family_of(plan.roads[0].spec)]["failed"] >= 1
    said = sentence(plan, result)
    assert (
        said.startswith("FAILED: the winner fails on 2 of 30 roads")
        and f"worst: {first}, nominal car, left lane" in said
    )
    assert "stability lost on 1, a requirement missed on 1" in said and "best manual set b: 1 of 30" in said
    assert len(set_table(result)) == 3 and len(family_table(plan, result)) >= 2


def test_the_worst_of_each_family_comes_before_a_second_one(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 40)
    family = plan.roads[0].family
    inside = [number for number, road in enumerate(plan.roads) if road.family == family]
    outside = next(number for number, road in enumerate(plan.roads) if road.family != family)
    names = {plan.roads[number].spec.name: 3.0 - i for i, number in enumerate(inside[:2])}
    names[plan.roads[outside].spec.name] = 0.6
    result = judged(plan, lambda job: grade(job, lateral_error_peak_m=names.get(job.scenario.name, 0.0)))
    assert [drive.road for drive in find_worst_drives(plan, result, 3)] == [inside[0], outside, inside[1]]


def test_a_winner_without_a_failure_passes_and_its_nearest_drive_is_shown(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 20)
    near = plan.roads[7].spec.name
    result = judged(plan, lambda job: grade(job, lateral_error_peak_m=0.45 if job.scenario.name == near else 0.1))
    [drive] = find_worst_drives(plan, result, 4)
    assert drive.road == 7 and decide_verdict(result, 0) is SweepVerdict.PASSED and family_table(plan, result) == []
    said = sentence(plan, result)
    assert said.startswith("PASSED: the winner fails on none of 20 roads (95 % interval 0 to 17 %)")
    assert "nearest to a limit" in said and "lateral_error_peak_m 0.45 <= 0.5" in said


def test_allowed_failures_pass(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 10)
    bad = {road.spec.name for road in plan.roads[:2]}
    result = judged(plan, lambda job: grade(job, replans=float(job.scenario.name in bad)))
    assert [decide_verdict(result, allowed).value for allowed in (0, 1, 2)] == ["FAILED", "FAILED", "PASSED"]
    assert sentence(plan, result, 2).startswith("PASSED: the winner fails on 2 of 10 roads")


@pytest.mark.parametrize("is_physical", [True, False])
def test_what_every_set_fails_is_left_out_only_for_a_physical_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_physical: bool
) -> None:
    plan = plan_of(tmp_path, 10)
    bad = plan.roads[4].spec.name
    excess = [PhysicalExcess(PhysicalLimit.DRIVE, 1.2)] if is_physical else []
    monkeypatch.setattr(module, "find_physical_excesses", lambda *_: excess)
    result = judged(plan, lambda job: grade(job, "left_lane" if job.scenario.name == bad else "finished"))
    data, said, family = sweep_data(plan, result), sentence(plan, result), plan.roads[4].family
    assert data["undrivable_roads"] == ([bad] if is_physical else [])
    assert result.winner.roads[:2] == ((0, 9) if is_physical else (1, 10))
    assert {pair["car"] for pair in data["undrivable" if is_physical else "every_set_fails"]} == {
        0,
        plan.roads[4].other_car,
    }
    if is_physical:
        assert f"undrivable for this vehicle, not counted: 2 drives of each set ({family} 2)" in said
        assert PhysicalLimit.DRIVE.value in said and said.startswith("PASSED")
    else:
        assert f"every set fails, without a physical reason, on 2 drives of each set ({family} 2) (counted)" in said


def test_a_failure_of_some_sets_is_no_fault_of_the_road(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_of(tmp_path, 10)
    monkeypatch.setattr(module, "find_physical_excesses", lambda *_: [PhysicalExcess(PhysicalLimit.GRIP, 2.0)])
    result = judged(plan, lambda job: grade(job, "left_lane" if job.values["station.kp"] == WINNER else "finished"))
    assert result.winner.roads.failed == 10 and not result.undrivable and not result.hopeless


def test_shares_are_said_with_their_intervals(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 20)
    bad = plan.roads[3].spec.name
    result = judged(plan, lambda job: grade(job, replans=float(job.scenario.name == bad)))
    assert share_text(result.winner.roads) == "1 of 20 roads (5 %, 95 % interval 0.13 to 25 %)"
