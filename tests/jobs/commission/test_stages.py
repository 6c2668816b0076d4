"""How the jobs of a commission are called, how they go on, and when what they came to will not do."""

from __future__ import annotations

import json
from typing import Any

import msgspec
import pytest

from tests import other_vehicle
from tests.jobs.made_chain import asked, chain, judged
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_bench
from tunefree_hil.jobs.commission import stages as jobs_of
from tunefree_hil.jobs.commission.gates import check_coverage, check_free_run, check_outside_share, read_free_run
from tunefree_hil.jobs.commission.plan import make_plan
from tunefree_hil.jobs.options.records import CommissionOptions

__all__ = ["asked", "chain"]  # fixtures


def test_the_bench_that_is_tuned_stands_on_what_was_learned(asked: CommissionOptions) -> None:
    plan = make_plan(asked)
    plan.folder.mkdir()
    text = plan.write_bench().read_text()
    assert str(plan.model.resolve()) in text and str((plan.map / "calibration.npz").resolve()) in text
    assert 'verify_model = "mkz_reference"' in text and "left_turn" in text


def test_the_steering_map_of_the_logs_is_driven_with(asked: CommissionOptions) -> None:
    plan = make_plan(asked)
    plan.map.mkdir(parents=True)
    assert "steering_map =" not in plan.write_bench().read_text()
    file = plan.map / "steering_map.toml"
    file.write_text("")
    assert f'steering_map = "{file.resolve()}"' in plan.write_bench().read_text()
    controller = msgspec.structs.replace(plan.template.controller, steering_map="data_sheet")
    chosen = plan._replace(template=msgspec.structs.replace(plan.template, controller=controller))
    assert str(file.resolve()) not in chosen.write_bench().read_text()


def test_a_bench_of_another_vehicle_is_refused(asked: CommissionOptions) -> None:
    with pytest.raises(InputError) as caught:
        make_plan(asked._replace(bench=other_vehicle.BENCH))
    assert caught.value.key == "vehicle"


def test_limits(asked: CommissionOptions) -> None:
    plan = make_plan(asked)
    assert check_coverage({"cells_full": 8, "cells_wanted": 10}, plan).is_passed
    assert not check_coverage({"cells_full": 0, "cells_wanted": 0}, plan).is_passed
    good = judged(2.0)
    assert read_free_run(good) == (2.0, 100, 0) and check_free_run(good, plan).is_passed
    assert "is 40.0 m" in check_free_run(judged(40.0), plan).reason
    assert "is 40.0 m" in check_free_run(judged(40.0, ground="hills"), plan).reason
    assert "in 3 of 100" in check_free_run(judged(2.0, n=97), plan).reason
    assert "in 100 of 100" in check_free_run(judged(None, n=0), plan).reason
    assert "long enough" in check_free_run({"kind": "hybrid", "free_run": {}}, plan).reason
    assert not check_outside_share({"outside": {"share": 0.5}}, plan).is_passed
    assert check_outside_share({}, plan).is_passed and check_outside_share({"outside": {"share": None}}, plan).is_passed


def test_a_tune_that_came_to_its_end_is_not_searched_again(
    asked: CommissionOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = make_plan(asked)
    wishes: list[Any] = []
    monkeypatch.setattr("tunefree_hil.jobs.tune.tune.tune", lambda wish: wishes.append(wish) or iter(()))
    with pytest.raises(InputError, match="no finished tune"):
        jobs_of.require_finished_tune(plan)
    for name, complete in (("1-tune-bench", True), ("2-tune-bench", False)):
        (plan.folder / "tune" / name).mkdir(parents=True)
        jobs_of.run_tune(plan)
        (plan.folder / "tune" / name / "run.json").write_text(json.dumps({"complete": complete}))
    jobs_of.run_tune(plan)
    finished = plan.folder / "tune" / "1-tune-bench"
    assert [wish.resume for wish in wishes] == [None, finished, finished]
    assert jobs_of.require_finished_tune(plan) == finished


def test_what_is_verified_is_what_the_bench_file_names_by_then(
    asked: CommissionOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = make_plan(asked)
    run = plan.folder / "tune" / "1-tune-bench"
    run.mkdir(parents=True)
    (run / "run.json").write_text(json.dumps({"complete": True}))
    (run / "bench.toml").write_text("of the day of the search")
    monkeypatch.setattr(jobs_of, "load", load_bench)  # the learned plant is not there
    monkeypatch.setattr("tunefree_hil.jobs.tune.folder.resolved_toml", lambda bench: f"{bench.verify_scenarios}")
    monkeypatch.setattr("tunefree_hil.jobs.tune.verify.verify", lambda _: iter(()))
    jobs_of.run_verify(plan)
    assert (run / "bench.toml").read_text() == f"{plan.template.verify_scenarios}"


def test_a_plant_that_was_written_is_not_trained_again(
    asked: CommissionOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = make_plan(asked)
    called: list[str] = []
    for name in ("learn", "report_result"):
        monkeypatch.setattr(
            f"tunefree_hil.jobs.learn.learn.{name}", lambda wish, name=name: called.append(name) or iter(())
        )
    jobs_of.run_learn(plan)
    plan.model.mkdir(parents=True)
    jobs_of.run_learn(plan)
    assert called == ["learn", "report_result"]


def test_what_a_killed_stage_half_wrote_is_out_of_the_way(
    asked: CommissionOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = make_plan(asked)
    for name in ("physics", "part-77-model"):
        (plan.folder / name).mkdir(parents=True)
    plan.remove_partial_folders()
    monkeypatch.setattr("tunefree_hil.jobs.learn.calibrate.calibrate", lambda *_: iter(()))
    jobs_of.run_calibrate(plan)
    assert [path.name for path in plan.folder.iterdir()] == ["physics-1"]
