"""A drive of a sweep that is made again over the bus, by the command that is printed, has the same score to the bit."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import tunefree
from tests.jobs.robustness.made_sweep import make_order, plan_of
from tunefree_hil.bench import load, model_of
from tunefree_hil.bench.scaling import scaled
from tunefree_hil.config.load import load_model
from tunefree_hil.jobs.robustness.driving.chunk import open_sweep_batch
from tunefree_hil.jobs.robustness.plan import SweepDrive, SweepPlan, make_plan
from tunefree_hil.jobs.robustness.worst_roads import write_drive

EFFECTS = 'effects = [{ name = "steer_offset", params = { offset_rad = 0.01 } }]\n'


def shortest_road(plan: SweepPlan) -> int:
    return min(range(len(plan.roads)), key=lambda number: plan.roads[number].spec.speed.t_s[-1])


def test_the_files_are_the_drive(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 5)
    number = shortest_road(plan)
    drive = SweepDrive(number, plan.roads[number].other_car, 1)
    job = plan.make_job(drive)
    for _ in range(2):  # an earlier drive is replaced
        command = shlex.split(write_drive(plan, drive, tmp_path / "again"))
    assert command[1:3] == ["drive", str(tmp_path / "again" / "bench.toml")] and command[-1] == str(job.seed)
    bench = load(tmp_path / "again" / "bench.toml")
    [scenario] = bench.scenarios.values()
    assert scenario.hash == job.scenario.hash and bench.spec.controller.parameters == dict(job.values)
    assert {one.name: one.params for one in bench.spec.effects} == job.effects
    model, wanted = load_model(tmp_path / "again" / "model"), scaled(model_of(plan.bench, plan.order.model), job.scale)
    assert model.actuators == wanted.actuators and model.plant == wanted.plant and model.effects == wanted.effects


def test_the_nominal_car_needs_no_model_of_its_own(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 3)
    command = shlex.split(write_drive(plan, SweepDrive(0, 0, 0), tmp_path / "again"))
    assert command[3:] == ["--model", plan.order.model] and not (tmp_path / "again" / "model").exists()


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize("is_nominal", [True, False])
def test_the_printed_command_drives_it_over_the_bus(tmp_path: Path, is_nominal: bool) -> None:
    bench = load(write_bench(tmp_path, more=EFFECTS))
    plan = make_plan(bench, make_order(bench, 5))
    number = shortest_road(plan)
    drive = SweepDrive(number, 0 if is_nominal else plan.roads[number].other_car, 0)
    with open_sweep_batch(plan) as batch:
        [driven] = batch.drive([plan.make_job(drive)])
    command = shlex.split(write_drive(plan, drive, tmp_path / "again"))
    ended = tunefree(*command[1:], "--json", "--out", tmp_path / "runs", patience_s=120.0)
    assert ended.status == 0, ended.words
    [road] = ended.data["scenarios"].values()
    assert driven.grade is not None and road["score"] == driven.grade.score
    assert road["requirements"] == dict(driven.grade.requirements)
