"""Measures over the whole envelope: fresh roads, error ratios, what is compared with what, the winner of the job."""

from __future__ import annotations

import csv
import io
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_scenario
from tests.house import ROOT
from tools.measures import _envelope, ceiling, corrections, tune11
from tools.measures._envelope import (
    DriveErrors,
    Progress,
    VehicleDrives,
    best_set,
    drive_errors,
    error_ratios,
    geometric_mean,
    mean_errors,
    on_roads,
    seed_of_commit,
    spread,
    unseen_roads,
    with_plain_controller,
)
from tools.measures._envelope_search import SearchRequest, find_winner
from tools.measures._ledger import Ledger
from tunefree_hil.bench import load, own_parameters, parameters_of, part_names
from tunefree_hil.config.dump import to_toml
from tunefree_hil.control.build import PEDAL_PREVIEW
from tunefree_hil.control.parameters import BASELINES
from tunefree_hil.grade.requirements.judgement import RequirementJudgement, RequirementResult
from tunefree_hil.jobs.options.records import BATCH, TuneOptions
from tunefree_hil.jobs.run_folder import open_run
from tunefree_hil.jobs.tune.tune import tune
from tunefree_hil.jobs.tune.verdict.best_file import read_best

FILES = _envelope.envelope_files()
METRICS = {"lateral_rms_after_start": 2.0, "station_rms_after_start": 0.4, "speed_rms_after_start": 1.0}


@pytest.fixture(scope="module", params=FILES, ids=lambda file: Path(file).stem)
def bench(request: pytest.FixtureRequest):
    return load(request.param)


def drives(
    errors: tuple[float, float, float], *, violated: float = 0.0, failed: tuple[str, ...] = (), score: float = 0.2
) -> VehicleDrives:
    results = (RequirementResult("lateral_error_peak_m", 0.5 * (1.0 + violated), 0.5, "a"),)
    judgement = RequirementJudgement(results, {}, failed)
    row = {"outcome": "finished", "replans": 0, "oscillation": None, "score": score, "metrics": METRICS}
    return VehicleDrives(score, DriveErrors(*errors), judgement, 0, 0, failed, {"a": {**row, "requirements": None}})


def winner(seed: int, **parameters: float) -> dict[str, Any]:
    known = {"seed": seed, "trial": 3, "trials": 9, "violation": 0.0, "score": 0.2, "edges": {}}
    return {**known, "parameters": parameters, "values": parameters}


def test_there_is_a_bench_of_the_whole_envelope_for_each_vehicle() -> None:
    assert len(FILES) == len({load(file).vehicle.name for file in FILES}) >= 2
    assert _envelope.envelope_files("a.toml,b.toml") == ["a.toml", "b.toml"]


def test_unseen_roads_follow_from_the_commit_and_no_search_has_them(bench) -> None:
    seed = seed_of_commit("ffffffff0123456789")
    assert seed == 2**32 - 1
    first, again, other = (unseen_roads(bench, 3, number) for number in (seed, seed, seed - 1))
    assert [road.hash for road in first] == [road.hash for road in again]
    assert not {road.hash for road in first} & {road.hash for road in other}
    assert not {road.hash for road in first} & {road.hash for road in bench.scenarios.values()}
    assert str(seed) in first[0].name
    alone = on_roads(bench, first)
    assert alone.spec.scenarios == [road.name for road in first] == list(alone.scenarios)
    assert alone.spec.verify_scenarios == [] and alone.spec.model == bench.spec.model


def test_an_error_has_its_unit_and_a_drive_without_it_does_not_count() -> None:
    drive = {"metrics": METRICS}
    assert drive_errors(drive) == {"lateral_m": 0.2, "station_m": 0.2, "speed_mps": 0.15}
    short = {"metrics": dict.fromkeys(METRICS)}
    double = {"metrics": {name: 2.0 * value for name, value in METRICS.items()}}
    assert mean_errors({"a": drive, "b": double, "c": short}) == pytest.approx((0.3, 0.3, 0.225))


def test_ratios_and_their_geometric_mean() -> None:
    found = error_ratios(DriveErrors(0.1, 0.2, 0.8), DriveErrors(0.2, 0.2, 0.1))
    assert found == pytest.approx(
        {"lateral_m": 0.5, "station_m": 1.0, "speed_mps": 8.0, "geometric_mean": 4.0 ** (1 / 3)}
    )
    assert geometric_mean([0.0, 2.0]) == 0.0


def test_the_best_manual_set_keeps_the_requirements_before_it_has_small_errors() -> None:
    small, large = (0.1, 0.1, 0.1), (0.2, 0.2, 0.2)
    sets = {"small": drives(small, violated=0.1), "large": drives(large)}
    assert best_set(sets) == ("large", True)
    assert best_set({"small": sets["small"], "other": drives(large, violated=0.1)}) == ("small", False)
    assert best_set({"cut": drives(small, failed=("a",)), "whole": drives(large, violated=3.0)}) == ("whole", False)
    assert best_set({"cut": drives(small, failed=("a",))}) == ("cut", False)


def test_the_plain_controller_is_that_of_a_bench_without_parts_and_knows_the_same_map(bench) -> None:
    plain = with_plain_controller(bench)
    assert part_names(plain) == ("lqr", "pid", "mrac")
    assert part_names(bench) != part_names(plain) and not own_parameters(plain)
    kept = ("riccati", "calibration", "look_ahead_m", "parameters")
    assert all(getattr(plain.spec.controller, key) == getattr(bench.spec.controller, key) for key in kept)
    assert plain.spec.model == bench.spec.model


def test_only_fresh_work_says_how_long_the_rest_takes(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    now = [100.0]
    monkeypatch.setattr(_envelope.time, "monotonic", lambda: now[0])
    progress = Progress("x", 100.0)
    progress.finish(50.0, "found", is_known=True)
    now[0] += 60.0
    progress.finish(10.0, "driven")
    now[0] += 1.0
    progress.update(5.0, "too soon for a line")
    now[0] += 59.0
    progress.update(10.0, "half way")
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["x 50 %: found (known)", "x 60 %, 4 min left: driven", "x 70 %, 3 min left: half way"]


def test_the_answer_is_the_worse_vehicle_and_its_detail_names_what_was_beaten() -> None:
    answers = tune11.VehicleAnswers(
        plain={"a": drives((0.4, 0.4, 0.4), score=0.8), "b": drives((0.1, 0.1, 0.1), violated=0.2)},
        improved={"a": drives((0.3, 0.3, 0.3))},
        winners=[winner(1, p=1.0), winner(2, p=3.0), winner(3, p=2.0)],
        tuned=[drives((0.1, 0.1, 0.1)), drives((0.2, 0.2, 0.2), violated=0.5), drives((0.05, 0.4, 0.2), score=0.4)],
        verdicts=[],
    )
    assert tune11.median_ratio(answers) == pytest.approx((0.125 * 1.0 * 0.5) ** (1 / 3))
    detail = tune11.describe_vehicle(answers)
    assert detail["largest_seed"] == pytest.approx(0.5) and detail["largest_single_ratio"] == pytest.approx(1.0)
    assert detail["requirements_met"] == "2 of 3" and detail["score_ratio"] == pytest.approx(0.25)
    assert (detail["plain_manual"]["name"], detail["plain_manual"]["is_met"]) == ("a", True)
    assert detail["parameters"] == {"p": [1.0, 2.0, 3.0]} == spread([{"p": 1.0}, {"p": 3.0}, {"p": 2.0}])
    rows = list(csv.DictReader(io.StringIO(tune11.answers_text({"v": answers}))))
    assert [(row["kind"], row["set"]) for row in rows[2:]] == [("improved manual", "a")] + [
        ("tuned", f"seed {i}") for i in (1, 2, 3)
    ]
    assert float(rows[0]["lateral_m"]) == 0.2 and rows[0]["lateral_rms_after_start"] == "2"


def test_ratios_without_the_roads_that_the_plain_controller_does_not_drive() -> None:
    half, unlike = ({name: share * value for name, value in METRICS.items()} for share in (0.5, 0.01))
    row = {"outcome": "finished", "replans": 0, "score": 0.2}
    plain = drives((0.4, 0.4, 0.4))._replace(
        drives={
            "kept": {**row, "metrics": METRICS},
            "left": {**row, "metrics": METRICS, "outcome": "left_lane"},
            "again": {**row, "metrics": METRICS, "replans": 2},
        }
    )
    tuned = drives((0.1, 0.1, 0.1))._replace(
        drives={
            "kept": {**row, "metrics": half},
            "left": {**row, "metrics": unlike},
            "again": {**row, "metrics": unlike},
        }
    )
    answers = tune11.VehicleAnswers({"a": plain}, {"a": plain}, [winner(1)], [tuned], [])
    found = tune11.describe_common_roads(answers)
    assert found.pop("roads") == 1 and found == pytest.approx(dict.fromkeys(found, 0.5)) and len(found) == 4
    none = plain._replace(drives={"left": plain.drives["left"]})
    assert tune11.describe_common_roads(answers._replace(plain={"a": none})) == {"roads": 0}


def test_the_bound_keeps_the_requirements_before_it_has_a_low_score() -> None:
    bounds = [drives((0.1, 0.1, 0.1), violated=0.1, score=0.1), drives((0.1, 0.1, 0.1), score=0.16)]
    tuned = [drives((0.2, 0.2, 0.2), score=score) for score in (0.24, 0.16)]
    found = ceiling.BoundAnswers(
        [winner(1, p=1.0), winner(2, p=1.0)], tuned, [winner(1, p=2.0), winner(2, p=2.0)], bounds
    )
    assert found.best == 1 and found.ratios == pytest.approx([1.5, 1.0])
    detail = ceiling.describe_vehicle(found)
    assert detail["median_ratio"] == pytest.approx(1.25) and detail["best_bound"] == 2
    assert detail["median_error_ratio"] == pytest.approx(2.0)


def test_all_corrections_together_are_the_controller_of_the_bench_file(bench) -> None:
    gains = corrections.GainSet("x", BASELINES["mrac_on"])
    everything = corrections.with_corrections(bench, corrections.CORRECTIONS)
    assert part_names(everything) == part_names(bench)
    assert everything.spec.controller == bench.spec.controller
    values = corrections.vector_of(bench, everything, corrections.CORRECTIONS, gains)
    assert values == parameters_of(bench, gains.values)
    switched_on = [name for one in corrections.CORRECTIONS for name in one.own]
    assert sorted(switched_on) == sorted(own_parameters(bench)), "each parameter of the parts is one correction's"


def test_a_correction_alone_leaves_the_others_off(bench) -> None:
    gains = corrections.GainSet("x", BASELINES["mrac_on"])
    for one in corrections.CORRECTIONS:
        corrected = corrections.with_corrections(bench, [one])
        values = corrections.vector_of(bench, corrected, [one], gains)
        off = {name: values[name] for name in own_parameters(corrected) if name not in one.own}
        assert set(off.values()) <= {0.0, values.get(PEDAL_PREVIEW, 0.0)}
        assert (corrected.spec.controller.steering_map is bench.spec.controller.steering_map) == one.is_map
    plain = corrections.with_corrections(bench, [])
    assert corrections.vector_of(bench, plain, [], gains) == parameters_of(plain, BASELINES["mrac_on"])


def test_a_row_is_compared_with_the_plain_controller_of_the_same_gains() -> None:
    variants = corrections.variants()
    assert len(variants) == 1 + 2 * len(corrections.CORRECTIONS)
    driven = [
        corrections.DrivenVariant("v", gains, variant, drives(errors))
        for gains, variant, errors in (
            ("mrac_on", variants[0], (0.4, 0.4, 0.4)),
            ("winner", variants[0], (0.2, 0.2, 0.2)),
            ("winner", variants[1], (0.1, 0.2, 0.4)),
            ("mrac_on", variants[-1], (0.1, 0.1, 0.1)),
        )
    ]
    rows = list(corrections.table_rows(driven))
    assert [row["error_ratio"] for row in rows] == pytest.approx([1.0, 1.0, 1.0, 0.25])
    assert [rows[2][f"{name}_ratio"] for name in _envelope.ERRORS] == pytest.approx([0.5, 1.0, 2.0])
    assert [corrections.is_complete(row) for row in rows] == [False, False, False, True]
    assert len(corrections.table_text(rows).splitlines()) == 5


@pytest.fixture
def short_bench(tmp_path: Path) -> Path:
    """A bench file of two short drives, which is verified on the plant that it is tuned on."""
    data = tomllib.loads((ROOT / "bench_configs" / "mkz_steer.toml").read_text())
    data |= {"scenarios": ["bend"], "verify_scenarios": ["other_bend"], "verify_model": data["model"]}
    data["tune"]["set"] = "complete"
    write_scenario(tmp_path, "bend", 6.0)
    write_scenario(tmp_path, "other_bend", 6.0, -0.03)
    path = tmp_path / "short_envelope.toml"
    path.write_text(to_toml(data))
    return path


@pytest.mark.compiled
def test_the_winner_is_that_of_the_command(short_bench: Path, tmp_path: Path) -> None:
    trials, seed = 48, 4
    progress = Progress("x", 1.0)
    found = find_winner(SearchRequest(str(short_bench), seed, trials), Ledger(tmp_path / "measure"), progress)
    options = TuneOptions(short_bench, trials=trials, seed=seed, backend=BATCH, verify=False, out=tmp_path / "run")
    results = [event.data for event in tune(options) if event.kind == "result"]
    best = read_best(open_run(Path(results[-1]["run"])))
    assert {name: best["parameters"][name] for name in found["parameters"]} == found["parameters"]
    scores = [score for score, _ in found["course"]]
    assert len(scores) == found["trials"] == trials
    assert found["trial"] > 8 and found["score"] == scores[found["trial"] - 1], "found by the sampler"


@pytest.mark.compiled
def test_the_measures_go_on_where_they_were(short_bench: Path, tmp_path: Path) -> None:
    options = {"roads": 1, "road_seed": 5, "benches": str(short_bench), "folder": str(tmp_path / "runs")}
    figures = str(tmp_path / "figures")
    answer = tune11.measure(seeds=1, trials=3, figures=figures, **options)
    detail = answer["detail"]["vehicles"]["short_envelope"]
    assert answer["n"] == 1 and answer["value"] == pytest.approx(detail["median_ratio"], rel=1e-3)
    bound = ceiling.measure(seeds=1, trials=6, winners=1, winner_trials=3, **options)
    assert bound["value"] > 0.0
    assert (tmp_path / "figures" / "tune11.png").stat().st_size > 10_000
    files = {path: path.read_bytes() for path in (tmp_path / "runs").rglob("*.jsonl")}
    assert tune11.measure(seeds=1, trials=3, figures=figures, **options)["value"] == answer["value"]
    assert ceiling.measure(seeds=1, trials=6, winners=1, winner_trials=3, **options)["value"] == bound["value"]
    assert {path: path.read_bytes() for path in (tmp_path / "runs").rglob("*.jsonl")} == files
