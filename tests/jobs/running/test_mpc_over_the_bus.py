"""MPC over the bus: the same frames again, and what becomes of a drive whose plans cannot be solved."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.bench.tiny import hash_of, write_bench
from tests.jobs.command import Ended, tunefree_alone
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, ControllerFor, load, parameters_of, require_buildable
from tunefree_hil.bench.batch import Batch
from tunefree_hil.bench.simulator import Simulator
from tunefree_hil.jobs.options.records import BATCH, TuneOptions
from tunefree_hil.jobs.running.episode_results import plan_counts, plan_warnings
from tunefree_hil.jobs.tune.options import make_tune_plan

PARTS = '[controller]\nlateral = "mpc"\nlongitudinal = "mpc"\n'
# A part of the user: that of the package with other criteria and a steering so slow that its bound is always active.
OWN = """
from dataclasses import replace
from tunefree_hil.control.lateral import mpc
from tunefree_hil.control.mpc.solver import MpcCriteria

def make(setup):
    vehicle = setup.vehicle._replace(steer_rate_radps={rate})
    return mpc.make(replace(setup, vehicle=vehicle), MpcCriteria({criteria}))

CONTROLLER = mpc.CONTROLLER._replace(make=make)
"""


def write_own_mpc(folder: Path, rate: float, criteria: str) -> Path:
    """A bench whose lateral part is OWN."""
    bench = write_bench(folder, more='[controller]\nlateral = "mine.py:CONTROLLER"\nlongitudinal = "mpc"\n')
    (folder / "mine.py").write_text(OWN.format(rate=rate, criteria=criteria))
    return bench


def drive(bench: Path, *more: str) -> Ended:
    return tunefree_alone("drive", bench, *more, "--bus", "tfhub", "--out", bench.parent / "runs", "--json")


def built(bench: Bench) -> None:
    require_buildable(bench, bench.spec.model, list(bench.scenarios.values()), parameters_of(bench))


@pytest.mark.parametrize("part", ["lateral", "longitudinal"])
def test_without_osqp_a_bench_is_refused_before_a_process_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    bench = load(write_bench(tmp_path, more=f'[controller]\n{part} = "mpc"\n'))
    built(bench)
    monkeypatch.setitem(sys.modules, "osqp", None)
    with pytest.raises(InputError, match="needs OSQP") as caught:
        built(bench)
    assert (caught.value.file, caught.value.key) == (bench.file, f"controller.{part}")
    assert "pip install" in caught.value.hint and caught.value.code == "no_osqp"


def test_the_batch_refuses_it_by_name(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path, more=PARTS))
    for driver in (Simulator, Batch):
        with pytest.raises(InputError, match="mpc is not compiled") as caught:
            driver(bench)
        assert (caught.value.code, caught.value.key) == ("not_in_batch", "controller.lateral")
        assert "over the bus" in caught.value.hint


def test_a_search_in_the_batch_is_refused_before_there_is_a_run(tmp_path: Path) -> None:
    path = write_bench(tmp_path, more=PARTS)
    make_tune_plan(TuneOptions(path, verify=False))
    with pytest.raises(InputError) as caught:
        make_tune_plan(TuneOptions(path, verify=False, backend=BATCH))
    assert (caught.value.code, caught.value.key) == ("not_in_batch", "controller.lateral")


def test_each_scenario_has_its_own_path_in_the_plan(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path, more=PARTS, scenarios=("tiny", "other")))
    assign = ControllerFor(bench)
    values = assign.indexed(parameters_of(bench))
    blocks = [assign(hash_of(tmp_path, name), values).block for name in ("tiny", "other")]
    for block in blocks:
        assert block.params.lateral.path is block.params.follower.path
    assert blocks[0].params.lateral.planner is blocks[1].params.lateral.planner, "it is built once"


def test_a_time_limit_is_for_real_time_alone(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path, more=PARTS))
    limits = []
    for is_realtime in (False, True):
        assign = ControllerFor(bench, is_realtime=is_realtime)
        block = assign(hash_of(tmp_path), assign.indexed(parameters_of(bench))).block
        planners = (block.params.lateral.planner, block.params.longitudinal.planner)
        limits.append([planner.solver._osqp.settings.time_limit for planner in planners])
    assert limits[1] == [planner.criteria.time_limit_s for planner in planners] and min(limits[0]) > 1e3


@pytest.mark.slow
class TestRealProcesses:
    def test_a_drive_is_the_same_again_and_after_another_one(self, tmp_path: Path) -> None:
        bench = write_bench(tmp_path, more=PARTS, scenarios=("tiny", "other"))
        both, alone = drive(bench), drive(bench, "--scenario", "other")
        assert both.status == 0 == alone.status, both.words + alone.words
        assert both.data["hashes"]["other"] == alone.data["hashes"]["other"]
        counts = plan_counts(Path(both.data["run"]) / "episodes" / "0")
        assert {name: row.ticks > 190 for name, row in counts.items()} == {"lateral": True, "longitudinal": True}
        assert plan_warnings(Path(both.data["run"]) / "episodes" / "0") == []
        other = drive(bench, "--scenario", "other", "--parameter", "mpc.q_lateral=1")
        assert other.data["hashes"]["other"] != alone.data["hashes"]["other"], "the weight arrives"

    def test_ticks_without_a_solution_are_counted_and_said(self, tmp_path: Path) -> None:
        done = drive(write_own_mpc(tmp_path, 0.02, "max_iterations=1, max_failed_ticks=100000"))
        assert done.status == 0, done.words
        episode = Path(done.data["run"]) / "episodes" / "0"
        counts = plan_counts(episode)["lateral"]
        assert counts.failed > 50 and counts.failed + counts.bounded <= counts.ticks
        assert f"lateral part: no solution on {counts.failed} of {counts.ticks} ticks" in done.words
        assert done.data["scenarios"]["tiny"]["outcome"] == "finished"

    @pytest.mark.parametrize(
        ("rate", "criteria"), [(0.02, "max_iterations=1"), (-1.0, "")], ids=["starved of iterations", "infeasible"]
    )
    def test_too_many_in_a_row_stop_the_vehicle(self, tmp_path: Path, rate: float, criteria: str) -> None:
        done = drive(write_own_mpc(tmp_path, rate, criteria))
        assert done.status == 0, done.words
        run = Path(done.data["run"])
        graded = done.data["scenarios"]["tiny"]
        assert (graded["outcome"], graded["score"]) == ("no_solution", 10.0)
        episode = json.loads((run / "episodes" / "0" / "episode.json").read_text())
        assert (episode["error"], episode["error_code"]) == ("no_solution", 14)
        assert "no_solution" in done.words and "not driven to the end: tiny" in done.data["sentence"]
        assert (
            "no_solution: supervision ended the drive; commands stop" in (run / "nodes" / "controller.txt").read_text()
        )
        assert plan_counts(run / "episodes" / "0")["lateral"].failed >= 20
