"""The measures and what they stand on: results that survive a kill, one process equal to three, honest comparisons."""

from __future__ import annotations

import importlib
import inspect
import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.bench.tiny import write_scenario
from tests.house import ROOT
from tools.measures import _ledger, _tuning, determinism, faults, hub, lockstep, mrac, realtime, tune2
from tools.measures._in_process import InProcess
from tools.measures._ledger import Ledger, meaning
from tools.measures._rig import Rig
from tools.measures._side_by_side import side_by_side
from tools.measures._summary import rounded
from tools.measures._tuning import standings
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.config.dump import to_toml
from tunefree_hil.config.load import load_model

STEER = ROOT / "bench_configs" / "mkz_steer.toml"
NAMES = sorted(path.stem for path in (ROOT / "tools" / "measures").glob("[!_]*.py"))


@pytest.fixture(scope="module")
def bench():
    return load(STEER)


@pytest.fixture
def short_bench(tmp_path: Path) -> Path:
    """mkz_steer with one scenario of 4 s each, verified on the plant it is tuned on: nothing to compile."""
    data = tomllib.loads(STEER.read_text())
    data |= {"scenarios": ["bend"], "verify_scenarios": ["other_bend"], "verify_model": data["model"]}
    write_scenario(tmp_path, "bend", 4.0)
    write_scenario(tmp_path, "other_bend", 4.0, -0.03)
    path = tmp_path / "short.toml"
    path.write_text(to_toml(data))
    return path


@pytest.mark.parametrize("name", NAMES)
def test_every_option_can_be_given_as_a_word(name: str) -> None:
    module = importlib.import_module(f"tools.measures.{name}")
    assert module.__doc__ and len(module.VALUE) > 10
    options = inspect.signature(module.measure).parameters.values()
    assert all(type(option.default) in (int, float, str) for option in options)


def test_a_line_is_found_by_what_it_depends_on(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path, "a")
    depends = {"code": "1", "values": {"x": 0.1, "y": math.inf}}
    assert ledger.find(depends) is None
    assert ledger.keep(depends, {"score": 0.25, "dropped": (1,)}) == {"score": 0.25, "dropped": [1]}
    again = Ledger(tmp_path, "b")
    assert again.find({"values": {"y": math.inf, "x": 0.1}, "code": "1"}) == {"score": 0.25, "dropped": [1]}
    assert again.find({**depends, "code": "2"}) is None
    again.keep({"other": 1}, 3)
    ledger.refresh()
    assert ledger.find({"other": 1}) == 3


@pytest.mark.parametrize("left", [1, 20, 60])
def test_a_line_that_was_cut_off_is_dropped_and_spoils_no_other(tmp_path: Path, left: int) -> None:
    ledger = Ledger(tmp_path)
    ledger.keep({"n": 1}, "one")
    ledger.keep({"n": 2}, "two")
    whole = ledger.path.read_bytes()
    first = whole.index(b"\n") + 1
    ledger.path.write_bytes(whole[: first + left])
    after = Ledger(tmp_path)
    assert (after.find({"n": 1}), after.find({"n": 2})) == ("one", None)
    after.keep({"n": 3}, "three")
    last = Ledger(tmp_path)
    assert [last.find({"n": n}) for n in (1, 2, 3)] == ["one", None, "three"]


def test_words_do_not_change_the_meaning_of_code_and_numbers_do() -> None:
    source = '"""A."""\nGAIN = 2.0\n\n\ndef f(x):\n    """Doubles."""\n    return GAIN * x\n'
    spoken = (
        '"""B."""\nGAIN   = 2.0  # of the loop\ndef f(x):\n    """Twice."""\n    # once more\n    return GAIN * x\n'
    )
    assert meaning(source) == meaning(spoken)
    assert meaning(source) != meaning(source.replace("2.0", "2.5"))
    assert meaning(source) != meaning(source.replace("GAIN * x", "x * GAIN"))


def test_what_scores_depend_on_is_there() -> None:
    for name in _ledger.COUNTED:
        assert (ROOT / "tunefree_hil" / name).exists(), name
    assert len(_ledger.code_hash()) == 64


def test_jobs_side_by_side_and_one_after_the_other_give_the_same() -> None:
    assert list(side_by_side(math.factorial, [3, 4, 5], 1)) == [6, 24, 120]


@pytest.mark.slow
def test_jobs_in_workers_are_all_done_and_a_failure_goes_through() -> None:
    assert sorted(side_by_side(math.factorial, [3, 4, 5, 6], 2)) == [6, 24, 120, 720]
    with pytest.raises(ValueError):
        list(side_by_side(math.factorial, [3, -1, 5], 2))


def test_standings_count_seed_by_seed_and_say_what_a_baseline_did() -> None:
    rows = {"a": [0.5], "b": [0.3], "random search": [0.2, 0.6, 0.4], "tuned": [0.4, 0.5, 0.2]}
    crash = {"u_turn": {"outcome": "left_lane", "replans": 2}, "left": {"outcome": "finished", "replans": 1}}
    fine = {"u_turn": {"outcome": "finished", "replans": 0}}
    found = standings(rows, {"a": {"scenarios": crash}, "b": {"scenarios": fine}})
    assert {name: one["beaten"] for name, one in found.items()} == {"a": 2, "b": 1, "random search": 2}
    assert found["a"]["words"] == "beats a (0.500) in 2 of 3 seeds; it re-plans 3 times; it fails u_turn"
    assert "re-plans" not in found["b"]["words"] and "fails" not in found["b"]["words"]


def test_a_plan_takes_the_bench_files_numbers_unless_told() -> None:
    plan = _tuning.make_plan(str(STEER), "x", trials=0, scenarios="", verify_scenarios="rav4_drive,no", folder="f")
    spec = load(STEER).spec
    assert (plan.trials, plan.scenarios) == (spec.tune.trials, tuple(spec.scenarios))
    assert plan.verify_scenarios == ("rav4_drive",)


def test_the_complete_bench_differs_only_in_what_is_searched() -> None:
    ours, complete = (tomllib.loads((STEER.parent / f"{n}.toml").read_text()) for n in ("mkz_steer", "mkz_complete"))
    assert complete.pop("tune") == {**ours.pop("tune"), "set": "complete", "trials": 100}
    assert ours == complete


def test_detail_is_cut_to_figures_that_mean_something() -> None:
    assert rounded({"a": [0.123456, (1234567.0,)], "b": True, "c": 7}) == {
        "a": [0.1235, [1235000.0]],
        "b": True,
        "c": 7,
    }


def test_a_percentile_has_an_interval_over_whole_seconds() -> None:
    rng = np.random.default_rng(3)
    late_s = 1e-4 * rng.standard_exponential(6000)
    low, high = realtime._interval_s(late_s, 100)
    assert low < float(np.percentile(late_s, 99)) < high < 2.0 * low


def test_only_the_steering_actuator_is_another_one(bench, tmp_path: Path) -> None:
    path = mrac.write_model(bench, tmp_path / "model", 0.15, 0.25, {"report.steer_rad": 0.02})
    changed, old = load_model(path), load_model(bench.spec.model)
    steer = changed.actuators["steer"]
    assert (steer.dead_time_s, steer.lag_s, steer.rate_limit) == (0.15, 0.25, old.actuators["steer"].rate_limit)
    assert (changed.plant, changed.noise, changed.timing) == (old.plant, old.noise, old.timing)
    assert changed.bias == {"report.steer_rad": 0.02}


@pytest.mark.slow
def test_one_process_sends_the_frames_of_three(bench, tmp_path: Path) -> None:
    """Design D1: the same source, so the same bits, whatever carries the frames."""
    values = parameters_of(bench, {"mrac.p": 0.003})
    graded, alone = InProcess(bench).grade(bench.scenarios["side_pass"], values)
    with Rig(bench, bench.spec.model, ["side_pass"], Ledger(tmp_path)) as rig:
        found = rig.evaluate(values)
    assert found["scenarios"]["side_pass"]["frame_hash"] == alone
    assert found["score"] == graded.score


@pytest.mark.slow
def test_a_failing_drive_is_the_same_in_one_process(bench, tmp_path: Path) -> None:
    values = parameters_of(bench, {"lqr.q1": 100.0, "lqr.q3": 0.01})
    graded, alone = InProcess(bench).grade(bench.scenarios["u_turn"], values)
    with Rig(bench, bench.spec.model, ["u_turn"], Ledger(tmp_path)) as rig:
        found = rig.evaluate(values)["scenarios"]["u_turn"]
    assert (graded.outcome, graded.score) == ("left_lane", 10.0)
    assert (found["frame_hash"], found["outcome"]) == (alone, "left_lane")


@pytest.mark.slow
def test_without_adaptation_p_does_not_matter(bench) -> None:
    drives, scenario = InProcess(bench), bench.scenarios["side_pass"]
    chosen = [{"mrac.p": 1e-4, "mrac.gamma": 0.0}, {"mrac.p": 0.1, "mrac.gamma": 0.0}, {"mrac.p": 0.1}]
    hashes = [drives.grade(scenario, parameters_of(bench, one))[1] for one in chosen]
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.slow
def test_a_straight_drive_shows_how_the_gains_move(tmp_path: Path) -> None:
    straight = mrac.Straight(str(STEER), str(tmp_path), "x", mrac.STRONGEST, {}, 1)
    label, moved = mrac.work_straight(straight)
    assert (label, moved["minutes"], moved["error"]) == ("x", 1.0, "")
    tau_s = (0.1 + 0.17) / 2.2
    assert moved["kr_start"] == pytest.approx(tau_s / mrac.STRONGEST["mrac.t_ref_s"], rel=1e-6)
    _, published = mrac.work_straight(straight._replace(label="y", dead_zone=0.0))
    assert 0.0 < abs(published["kx_change_second_half"]) <= 2.0 * published["kx_largest_change"]
    assert moved["kx_largest_change"] < 0.5 * published["kx_largest_change"]
    assert 0.0 < moved["steer_end_rad"] < 0.5


@pytest.mark.compiled
def test_tuning_is_measured_and_goes_on_where_it_was(short_bench: Path, tmp_path: Path) -> None:
    options = {"seeds": 1, "trials": 2, "workers": 1, "bench": str(short_bench)}
    options |= {"folder": str(tmp_path / "runs"), "figures": str(tmp_path / "figures")}
    answer = tune2.measure(**options)
    detail = json.loads(json.dumps(answer))["detail"]
    assert answer["n"] == 1 and answer["value"] > 0.0
    assert {"as_shipped", "mrac_on", "rule_based", "random search"} <= detail["beaten"].keys()
    manual = detail["beaten"][detail["manual"]]["scores"][0]
    assert answer["value"] == pytest.approx(detail["seeds"][0]["tuned"]["unseen"] / manual, rel=1e-3)
    assert (tmp_path / "figures" / "tune2.png").stat().st_size > 10_000
    lines = _lines(tmp_path)
    assert tune2.measure(**options)["value"] == answer["value"]
    assert _lines(tmp_path) == lines  # nothing was driven again


def _lines(folder: Path) -> int:
    return sum(len(path.read_text().splitlines()) for path in folder.rglob("*.jsonl"))


@pytest.mark.slow
def test_a_disturbed_drive_has_the_hash_of_a_quiet_one() -> None:
    answer = determinism.measure(runs=2, burners=1, scenario="side_pass", seed=4)
    assert (answer["value"], answer["n"]) == (1, 2)
    assert answer["detail"]["same_as_in_one_process"]
    assert all(one["held_up"] > 3 and one["ticks"] > 1000 for one in answer["detail"]["runs"])


@pytest.mark.slow
def test_speed_and_hub_are_measured() -> None:
    speed = lockstep.measure(runs=1, scenarios="side_pass", reference=0)
    assert (speed["unit"], speed["n"]) == ("x real time", 1) and speed["value"] > 0.0
    assert speed["detail"]["mkz_nominal"]["frames_per_s"] > 0.0
    answer = hub.measure(runs=1, rounds=200)
    unix = answer["detail"]["unix"]
    assert 0.0 < answer["value"] <= unix["round_trip_p99_us"]["median"]


@pytest.mark.slow
def test_no_fault_of_a_sample_is_silent_and_a_silent_one_would_be_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    found = faults.measure(every=37)
    assert (found["value"], found["detail"]["silent"]) == (0, [])
    assert found["n"] + found["detail"]["not_detectable_by_protocol"] == found["detail"]["rows"] > 20
    monkeypatch.setattr(faults, "kinds_of", lambda message: [])
    monkeypatch.setitem(faults.DRIVERS, "steer", 0.5)  # Nm: no override, so nobody has anything to say
    rows = faults.rows_of(load(STEER))
    assert {row.where for row in rows if row.answer == faults.SILENT} == {"steer"} and len(rows) == 3 * 6


@pytest.mark.slow
def test_a_fault_of_a_single_frame_is_not_silent_either() -> None:
    found = faults.measure(every=47, frames=1)
    assert (found["value"], found["detail"]["silent"]) == (0, []) and found["n"] > 10
