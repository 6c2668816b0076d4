"""best.toml by verdict: what may be pasted, what its first line says, and that every reader finds the winner."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.grade.requirements.verdict import DecidedGains, decide_verdict, judge_gains
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune.verdict.best_file import DrivenOn, read_best, write_best

LIMITS = {"steer_oscillation_rad": 0.05}
WINNER = {"schema": "tunefree.best/1", "slot": 3, "tuned": {"mrac.p": 0.01}, "parameters": {"mrac.p": 0.01, "x": 1.0}}
VECTORS = {"mrac_on": {"mrac.p": 1e-4, "x": 1.0}, "as_shipped": {"mrac.p": 2e-4, "x": 1.0}}
VERIFIED = DrivenOn("mkz_reference", ["lane_change_29mps", "bend"], 7)
SEARCHED = VERIFIED._replace(is_verified=False)


def decided(score: float, wheel_rad: float, manual_rad: float = 0.01) -> DecidedGains:
    def judged(score: float, wheel_rad: float) -> Any:
        calm = {"outcome": "finished", "requirements": {"steer_oscillation_rad": 0.0}}
        shaking = {"outcome": "finished", "requirements": {"steer_oscillation_rad": wheel_rad}}
        return judge_gains(score, {"bend": calm, "lane_change_29mps": shaking}, LIMITS)

    return decide_verdict(judged(score, wheel_rad), {"mrac_on": judged(0.2, manual_rad)})


def written(folder: Path, verdict: DecidedGains, driven: DrivenOn = VERIFIED, winner: Any = WINNER) -> tuple[str, Any]:
    run = RunFolder(folder, {})
    write_best(run, winner, verdict, driven, VECTORS, "OSCILLATES" if verdict.tuned.judgement.violation else "")
    text = (folder / "best.toml").read_text()
    assert not list(folder.glob("*.part"))
    assert read_best(run)["parameters"] == WINNER["parameters"], "readers find the winner whatever the verdict"
    return text, tomllib.loads(text)


def test_an_accepted_winner_has_its_verification_in_it(tmp_path: Path) -> None:
    text, best = written(tmp_path, decided(0.1, 0.04))
    assert best["verdict"] == "ACCEPTED" and best["parameters"] == WINNER["parameters"]
    verification = best["verification"]
    assert (verification["model"], verification["roads"], verification["seed"]) == VERIFIED[:3]
    assert verification["requirements"]["steer_oscillation_rad"] == {
        "value": 0.04,
        "limit": 0.05,
        "road": "lane_change_29mps",
        "met": True,
    }
    assert "paste" in text.splitlines()[0] and best["slot"] == 3 and best["tuned"] == WINNER["tuned"]


def test_a_rejected_winner_cannot_be_pasted_and_a_manual_set_is_offered(tmp_path: Path) -> None:
    text, best = written(tmp_path, decided(0.1, 1.02))
    head = text.splitlines()[0]
    assert head == "# REJECTED: steer_oscillation_rad 1.02 > 0.05 on lane_change_29mps: do not paste"
    assert "parameters" not in best and best["rejected_parameters"] == WINNER["parameters"]
    assert best["controller"]["parameters"] == VECTORS["mrac_on"]
    assert best["verification"]["oscillation"] == "OSCILLATES"


def test_where_no_manual_set_meets_them_none_is_offered_and_what_binds_is_said(tmp_path: Path) -> None:
    text, best = written(tmp_path, decided(0.1, 1.02, 0.1))
    assert "controller" not in best
    assert "no manual set meets the requirements" in text.splitlines()[1] and "by 100 %" in text.splitlines()[1]


def test_one_without_a_gain_names_the_manual_set(tmp_path: Path) -> None:
    text, best = written(tmp_path, decided(0.2, 0.01))
    assert best["verdict"] == "NO GAIN" and text.startswith("# NO GAIN: the manual set mrac_on")
    assert best["parameters"] == WINNER["parameters"]


def test_it_is_not_verified_until_it_is_and_every_verification_replaces_the_last(tmp_path: Path) -> None:
    _, best = written(tmp_path, decided(0.1, 0.01), SEARCHED)
    assert best["verdict"] == "not verified" and "verification" not in best
    run = RunFolder(tmp_path, {})
    _, best = written(tmp_path, decided(0.1, 1.02), winner=read_best(run))
    assert best["verdict"] == "REJECTED" and "parameters" not in best
    _, best = written(tmp_path, decided(0.1, 0.01), winner=read_best(run))
    assert best["verdict"] == "ACCEPTED" and not {"rejected_parameters", "controller"} & set(best)


def test_a_winner_that_violates_them_on_the_searched_roads_is_rejected_at_once(tmp_path: Path) -> None:
    _, best = written(tmp_path, decided(0.1, 1.02), SEARCHED)
    assert best["verdict"] == "REJECTED" and best["verification"]["is_verified"] is False


def test_a_file_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    (tmp_path / "best.toml").write_text("slot = 3\n\n[parameters]\nlat_kp = 0.5\n")
    assert read_best(RunFolder(tmp_path, {})) == {"slot": 3, "parameters": {"lat_kp": 0.5}}
    (tmp_path / "best.toml").write_text("slot = 3\n\n[controller.parameters]\nlat_kp = 0.5\n")
    with pytest.raises(InputError, match="is missing"):
        read_best(RunFolder(tmp_path, {}))
