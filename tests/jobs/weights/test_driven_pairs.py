"""Driven pairs: drivers and gains on the same roads, kept road by road; a killed command continues."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

from tests.house import ROOT
from tests.jobs.command import eventually, finish, start
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.jobs.weights.driven_pairs import make_plan, with_driver
from tunefree_hil.jobs.weights.gain_sets import DRIVERS, RANDOM, VARIED_SETS, make_driver_vectors, make_gain_sets
from tunefree_hil.jobs.weights.options import WeightsOptions

BENCH = ROOT / "bench_configs" / "mkz_learned.toml"
PURSUIT = ROOT / "bench_configs" / "mkz_pursuit.toml"
PATIENCE_S = 280.0


def options(out: Path, **changes: object) -> WeightsOptions:
    return WeightsOptions(out=out, bench=BENCH, roads=3, sets=2)._replace(**changes)


def test_sets_are_of_varied_quality_and_follow_from_the_seed() -> None:
    bench = load(BENCH)
    sets, again, other = (make_gain_sets(bench, 2, seed) for seed in (1, 1, 2))
    assert sets == again and sets[f"{RANDOM} 1"] != other[f"{RANDOM} 1"]
    assert {"as_shipped", "rule_based", *VARIED_SETS} <= set(sets)
    assert sets["sharp_steering"]["lqr.q1"] > sets["mrac_on"]["lqr.q1"] > sets["slow_steering"]["lqr.q1"]
    assert sets["sharp_pedals"]["lqr.q1"] == sets["mrac_on"]["lqr.q1"]


def test_drivers_look_further_ahead_with_slower_arms() -> None:
    vectors = make_driver_vectors(with_driver(load(BENCH)))
    assert set(vectors) == set(DRIVERS)
    assert vectors["driver_calm"]["steer.preview"] > vectors["driver_alert"]["steer.preview"] > 1.0


def test_a_controller_of_the_user_is_refused() -> None:
    with pytest.raises(InputError, match="built-in") as error:
        make_gain_sets(load(PURSUIT), 2, 1)
    assert error.value.key == "controller"


def test_drives_of_something_else_are_not_taken(tmp_path: Path) -> None:
    plan = make_plan(options(tmp_path / "my.toml"))
    changed = [make_plan(options(tmp_path / "my.toml", **change)) for change in ({"sets": 3}, {"base": "paper"})]
    assert len({plan.identity, *(one.identity for one in changed)}) == 3
    assert plan.identity == make_plan(options(tmp_path / "other.toml", roads=4)).identity


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.timeout(900)
def test_a_killed_command_continues_and_gives_the_same_weights(tmp_path: Path) -> None:
    words = ["weights", "--bench", BENCH, "--roads", 4, "--sets", 2, "--plain", "--json"]
    whole = finish(start(*words, "--out", tmp_path / "whole.toml", cwd=tmp_path), PATIENCE_S)
    assert whole.status == 0, whole.words
    drives = tmp_path / "cut" / "drives"
    killed = start(*words, "--out", tmp_path / "cut.toml", cwd=tmp_path)
    eventually(lambda: list(drives.glob("*.json")), PATIENCE_S, "the first road")
    os.kill(killed.pid, signal.SIGKILL)
    killed.communicate()
    n_driven = len(list(drives.glob("*.json")))
    assert not (tmp_path / "cut.toml").exists()
    resumed = finish(start(*words, "--out", tmp_path / "cut.toml", cwd=tmp_path), PATIENCE_S)
    assert resumed.status == 0, resumed.words
    assert f"{n_driven} of 4 roads were driven before" in resumed.words
    reports = [json.loads((tmp_path / name / "report.json").read_text()) for name in ("whole", "cut")]
    assert reports[0] == reports[1]
    assert reports[0]["accuracies"]["model"]["regressed"]["n"] > 30
