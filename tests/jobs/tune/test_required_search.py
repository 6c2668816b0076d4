"""A whole search under requirements, its drives made in this process: what wins, what is written, what is warned of."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import cast

import pytest

from tests.bench.tiny import write_bench, write_scenario
from tunefree_hil.bench import load
from tunefree_hil.bench.batch import Batch
from tunefree_hil.bench.parallel import Fleet
from tunefree_hil.jobs.options.records import TuneOptions
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune import tune
from tunefree_hil.jobs.tune.evaluators import BatchEvaluator
from tunefree_hil.jobs.tune.options import make_tune_plan
from tunefree_hil.jobs.tune.report import TuneReport, write_tune_report
from tunefree_hil.jobs.tune.robustness import RobustnessResult
from tunefree_hil.jobs.tune.search import TrialSearch
from tunefree_hil.tune.journal import Journal, open_journal

DURATION_S = 5.0  # two seconds of it count


def searched(folder: Path, require: str) -> tuple[Journal, TuneReport]:
    bench_file = write_bench(folder, duration_s=DURATION_S, more=f"[require]\n{require}\n")
    plan = make_tune_plan(TuneOptions(bench_file, backend="batch", trials=3))
    run = RunFolder(folder, {})
    journal = open_journal(folder / "trials.jsonl", plan.settings)
    fleet = Fleet(plan.bench, plan.bench.spec.model, (), 1)
    scenarios = [plan.bench.scenarios[name] for name in plan.bench.spec.scenarios]
    evaluator = BatchEvaluator(cast(Batch, fleet), plan.bench, scenarios, batch_size=8)
    search = TrialSearch(plan, run, evaluator, journal)
    list(search.score_baselines())
    list(search.run_trials())
    fleet.close()
    return journal, write_tune_report(plan.bench, run, journal, RobustnessResult())


def test_every_trial_says_by_how_much_it_meets_them(tmp_path: Path) -> None:
    journal, report = searched(tmp_path, "lateral_error_peak_m = 0.5")
    for trial in journal.trials():
        values = trial.scenarios["tiny"]["requirements"]
        assert 0.0 < values["lateral_error_peak_m"] < 0.5 and values["replans"] == 0.0
        assert trial.violation == 0.0
    assert report.data["verdict"] in ("ACCEPTED", "NO GAIN") and report.data["requirements"]["met"]
    assert any(line.startswith("lateral_error_peak_m") for line in report.lines)
    assert tomllib.loads((tmp_path / "best.toml").read_text())["verdict"] == "not verified"


def test_requirements_that_nothing_meets_reject_the_winner_and_name_what_binds(tmp_path: Path) -> None:
    journal, report = searched(tmp_path, "lateral_error_peak_m = 0.002")
    trials = journal.trials()
    assert all(trial.violation > 1.0 for trial in trials)
    least = min(trials, key=lambda trial: trial.violation)
    assert report.data["best"]["slot"] == least.slot, "the least violation wins, not the score"
    assert report.data["verdict"] == "REJECTED"
    text = (tmp_path / "best.toml").read_text()
    assert text.startswith("# REJECTED: lateral_error_peak_m") and "rejected_parameters" in tomllib.loads(text)


@pytest.mark.parametrize("speed_mps", [5.0, 9.0])
def test_a_road_to_be_verified_beyond_the_searched_speed_is_warned_of(tmp_path: Path, speed_mps: float) -> None:
    file = write_bench(tmp_path)
    road = write_scenario(tmp_path, "faster")
    road.write_text(road.read_text().replace("5.0, 5.0", f"{speed_mps}, {speed_mps}"))
    road.write_text(road.read_text().replace("speed_mps = 5.0", f"speed_mps = {speed_mps}"))
    text = file.read_text()
    file.write_text(text.replace('verify_scenarios = ["tiny"]', 'verify_scenarios = ["tiny", "faster"]'))
    found = tune.find_uncovered_roads(load(file))
    events = list(tune._warn_uncovered(found))
    if speed_mps == 5.0:
        assert not found and not events
        return
    assert {beyond.road for beyond in found} == {"faster"}
    (warning,) = events
    assert warning.kind == "warning" and "faster is to be verified, and lies outside" in warning.message


def test_roads_that_are_faster_than_the_data_of_the_model_are_warned_of(repo: Path) -> None:
    """The learned car was driven up to 23.5 m/s, the roads of its bench reach 30 m/s; the slow study's do not."""
    (warning,) = tune.warn_faster_than_data(load(repo / "bench_configs" / "mkz_envelope.toml"))
    low, high = warning.data["valid_mps"]
    assert warning.kind == "warning" and low < 1.0 < 20.0 < high < 25.0
    assert warning.data["faster"] and all(
        int(name.partition("mps")[0].rpartition("_")[2]) > 20 for name in warning.data["faster"]
    )
    assert f"of 16 searched roads are faster than the data of model mkz_learned ({high:.1f} m/s)" in warning.message
    assert not list(tune.warn_faster_than_data(load(repo / "bench_configs" / "mkz_learned.toml")))
