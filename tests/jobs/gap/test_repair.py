"""A repair that closes nothing on the holdout blocks rejects its effects."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from tests.gap.made_answer import SECONDS, VEHICLE, answer, late_drive, made_kept, made_model
from tests.jobs.ended import ended
from tests.learn.made_drives import CHANNELS, made_drive
from tunefree_hil.gap.measured.chain import build_measured_drive
from tunefree_hil.jobs.gap.acceptance import has_no_gain, is_absent_from_holdout, needs_further_drive
from tunefree_hil.jobs.gap.folder import GapFolder
from tunefree_hil.jobs.gap.options import GapInputs, GapOptions
from tunefree_hil.jobs.gap.repair import make_repair, repair_fields, verify_repair
from tunefree_hil.jobs.gap.report import write_page
from tunefree_hil.jobs.gap.report_text import describe_answer, suggest_commands
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.plant.data_sheet import DEFAULTS

WORDS = "steer_dead_time fits best, but the repair closes nothing of the gap in the holdout blocks"
STEER = "report.steer_rad"


def proof_of(drive: Drive, out: Path, *, faint: bool = False, drives: bool = True) -> tuple[dict[str, Any], list[str]]:
    """(keys of gap.json, warnings) of a search that named a later steering. drives: whether the car is in gear."""
    material, opened = (
        GapInputs(VEHICLE, made_model(), made_model(), [drive], []),
        [build_measured_drive(drive, VEHICLE)],
    )
    opened = [one._replace(is_moving=one.is_moving & drives) for one in opened]
    folder, kept = GapFolder(out), made_kept()
    named = [{**one, "faint": faint} for one in kept.answer["effects"]]
    kept = kept._replace(answer={**kept.answer, "effects": named})
    mended = make_repair(folder, material, opened, kept, "sha256:0")
    (data, _), events = ended(verify_repair(folder, material, opened, kept, mended))
    return data, [event.message for event in events if event.kind == "warning"]


def test_a_name_that_closes_the_gap_stays(tmp_path: Path) -> None:
    data, warnings = proof_of(late_drive(), tmp_path)
    assert "taken_back" not in data and data["explained_frac"]["value"] > 0.8 and warnings == []
    assert (tmp_path / "model" / "model.toml").is_file()


def test_a_name_that_closes_nothing_is_taken_back_with_its_model(tmp_path: Path) -> None:
    """The car has no such delay."""
    data, warnings = proof_of(made_drive(SECONDS, seed=5, name="as_modelled.log"), tmp_path)
    assert data["effects"] == [] and data["words"] == [WORDS] and warnings == [f"rejected: {WORDS}"]
    (reason,) = data["reasons"]
    assert reason["name"] == "steer_dead_time" and reason["criterion"] == "gap_not_closed" and reason["value"] < 0.0
    assert data["model"] is None and not (tmp_path / "model").exists()
    assert data["taken_back"]["names"] == ["steer_dead_time"] and data["taken_back"]["explained_frac"]["value"] < 0.0


@pytest.mark.parametrize("faint", [False, True])
def test_where_nothing_can_be_proved_a_faint_name_is_none(tmp_path: Path, faint: bool) -> None:
    data, warnings = proof_of(late_drive(), tmp_path, faint=faint, drives=False)
    assert "no holdout block is complete" in warnings[0] and data["explained_frac"] is None
    assert ("taken_back" in data) == faint == (not (tmp_path / "model").exists())
    assert not faint or (data["effects"], data["model"]) == ([], None)


def page_of(folder: Path, told: Mapping[str, Any]) -> str:
    whole = {**told, "log_hash": "", "logs": [], "figures": []}
    whole |= {"until": "verify", "model_hash": "", "vehicle_hash": "", "version": ""}
    write_page(folder / "gap.md", {**whole, "sentence": describe_answer(whole)}, [], "again")
    return (folder / "gap.md").read_text()


@pytest.mark.parametrize(("grown", "said"), [({}, False), ({"report.speed_mps": 0.2}, True)])
def test_what_grew_by_chance_is_said_where_the_model_is_kept(
    grown: dict[str, float], said: bool, tmp_path: Path
) -> None:
    one = {"before": 1.0, "recalibrated": 1.0, "after": 1.2, "floor": 0.5, "unforetold": None, "unit": "m/s"}
    whole = {**answer(), "signals": {"report.speed_mps": one}, "proof_blocks": 5, "explained_frac": None, "older": []}
    whole |= {"model": "out/model", "changes": [], "worse": [], "grown": grown}
    assert ("differ by chance: report.speed_mps by 20 %" in page_of(tmp_path, whole)) is said
    assert "by chance" not in page_of(tmp_path, {**whole, "model": None})


def test_a_model_that_closes_nothing_is_not_kept_and_that_is_said() -> None:
    one = {**answer(), "explained_frac": {"value": 0.0, "low": 0.0, "high": 0.0}, "worse": []}
    told = describe_answer(one)
    assert "is missing; no model is written" in told and "closes nothing" in told
    assert has_no_gain(one) and not has_no_gain({**one, "explained_frac": None})


def test_a_model_of_what_the_proof_does_not_show_waits_for_another_drive() -> None:
    shown = {**answer(), "explained_frac": None, "worse": [], "model": "out/model"}
    unseen = {**shown, "effects": [{**shown["effects"][0], "unseen_stirs": 0.0}]}
    assert (
        is_absent_from_holdout(unseen)
        and not is_absent_from_holdout(shown)
        and not is_absent_from_holdout({"effects": []})
    )
    for closes, waits in ((None, True), (0.0, True), (0.015, True), (0.4, False)):
        one = {**unseen, "explained_frac": closes and {"value": closes, "low": closes, "high": closes}}
        assert needs_further_drive(one) == waits == ("another drive has to confirm the model" in describe_answer(one))
    assert not needs_further_drive({**unseen, "model": None}) and not needs_further_drive(shown)


@pytest.mark.parametrize(("stirs", "stays"), [(0.0, True), (0.99, False)])
def test_a_repair_that_closes_nothing_is_kept_where_those_blocks_do_not_show_it(
    stirs: float, stays: bool, tmp_path: Path
) -> None:
    """It leaves the car as it was, whose own steering is late there: by no delay no gap is closed."""
    kept = made_kept()
    none = {"delay_s": {"value": 0.0, "low": 0.0, "high": 0.0, "unit": "s"}}
    seen = {"unseen_stirs": stirs, "unseen_shrink": 0.0, "params": none}
    named = [{**one, **seen} for one in kept.answer["effects"]]
    kept = kept._replace(
        answer={**kept.answer, "effects": named},
        recalibrated_values={},
        repaired_values={"steer_dead_time.delay_s": 0.0},
    )
    material, opened = (
        GapInputs(VEHICLE, made_model(), made_model(), [late_drive()], []),
        [build_measured_drive(late_drive(), VEHICLE)],
    )
    mended = make_repair(GapFolder(tmp_path), material, opened, kept, "sha256:0")
    (data, _), _ = ended(verify_repair(GapFolder(tmp_path), material, opened, kept, mended))
    assert data["explained_frac"]["value"] == pytest.approx(0.0, abs=1e-6) and "taken_back" not in data
    assert ("model" not in data) == stays == (tmp_path / "model" / "model.toml").is_file()
    page = page_of(tmp_path, {**kept.answer, "model": str(tmp_path / "model"), **data})
    assert ("They do not show what is missing" in page) == stays == ("The repair closes" not in page)


def test_what_is_before_and_what_is_changed_is_of_the_model_in_its_folder(tmp_path: Path) -> None:
    """And not of what its own logs say of it, which the search is about: here a motor that gives half as much."""
    given, drive = made_model(), late_drive()
    weak = replace(given.plant, params={**given.plant.params, "drive_force_n": 0.5 * DEFAULTS["drive_force_n"]})
    material, opened = (
        GapInputs(VEHICLE, given, replace(given, plant=weak), [drive], []),
        [build_measured_drive(drive, VEHICLE)],
    )
    kept = made_kept()._replace(recalibrated_values={})
    mended = make_repair(GapFolder(tmp_path), material, opened, kept, "sha256:0")
    (data, _), _ = ended(verify_repair(GapFolder(tmp_path), material, opened, kept, mended))
    speed = data["signals"]["report.speed_mps"]
    told = page_of(tmp_path, {**kept.answer, **repair_fields(mended), **data})
    assert data["grown"] == {} and any("report.speed_mps" in one for one in data["worse"]), "beyond chance"
    assert data["from_own_logs"] and "from the parameters that the calibration logs gave" in told
    assert speed["before"] < 0.5 * speed["recalibrated"], "the folder's model has the motor right"
    (force,) = (one for one in repair_fields(mended)["changes"] if one["key"].endswith("drive_force_n"))
    assert force["after"] == pytest.approx(weak.params["drive_force_n"]) and force["before"] != force["after"]


def very_late(later_s: float) -> Drive:
    late = CHANNELS["steer"]._replace(dead_time_s=CHANNELS["steer"].dead_time_s + later_s)
    return made_drive(SECONDS, seed=5, channels={**CHANNELS, "steer": late}, name="late.log")


@pytest.mark.parametrize(("later_s", "verdict"), [(0.0, None), (1.5, "none_of_these")])
def test_what_only_the_blocks_that_prove_miss_grossly_is_not_nothing(
    tmp_path: Path, later_s: float, verdict: str | None
) -> None:
    drive, model = very_late(later_s), made_model()
    material, kept = (
        GapInputs(VEHICLE, model, model, [drive], []),
        made_kept("none_missing", words=["nothing", "short"]),
    )
    opened = [build_measured_drive(drive, VEHICLE)]
    mended = make_repair(GapFolder(tmp_path), material, opened, kept, "sha256:0")
    (data, _), _ = ended(verify_repair(GapFolder(tmp_path), material, opened, kept, mended))
    assert data.get("verdict") == verdict and list(data.get("missed_in_proof", ()))[:1] == ([STEER] if verdict else [])
    if verdict:
        assert data["reasons"][0]["criterion"] == "missed_in_holdout" and data["reasons"][0]["signal"] == STEER
        whole = {**kept.answer, **data}
        assert whole["words"][1:] == ["short"] and f"{STEER} by " in whole["words"][0]
        assert "that the search could not see: the holdout blocks" in describe_answer(whole)
        asked = GapOptions([Path("a.log")], "car", "model", Path("out"))
        (command,) = suggest_commands(asked, whole, VEHICLE)
        assert "NEXT.log" in command


def test_so_is_a_name_that_was_taken_back(tmp_path: Path) -> None:
    """No link was broken, and of the delay that was named the proof knows nothing."""
    drive = very_late(1.5)
    kept = made_kept()
    unbroken = [{**one, "broken": False} for one in kept.answer["links"]]
    faint = [{**one, "faint": True, "evidence": 20.0} for one in kept.answer["effects"]]
    kept = kept._replace(
        answer={**kept.answer, "links": unbroken, "effects": faint}, repaired_values={"steer_dead_time.delay_s": 0.0}
    )
    material, opened = (
        GapInputs(VEHICLE, made_model(), made_model(), [drive], []),
        [build_measured_drive(drive, VEHICLE)],
    )
    mended = make_repair(GapFolder(tmp_path), material, opened, kept, "sha256:0")
    (data, _), _ = ended(verify_repair(GapFolder(tmp_path), material, opened, kept, mended))
    assert data["taken_back"]["names"] == ["steer_dead_time"] and data["effects"] == [] and data["model"] is None
    assert data["verdict"] == "none_of_these" and next(iter(data["missed_in_proof"])) == STEER


@pytest.mark.parametrize(("late", "stays"), [(True, True), (False, False)])
def test_older_logs_are_asked_where_nothing_else_can_prove(late: bool, stays: bool, tmp_path: Path) -> None:
    older = late_drive(SECONDS, 9) if late else made_drive(SECONDS, seed=9, name="before.log")
    material, whole = (
        GapInputs(VEHICLE, made_model(), made_model(), [late_drive()], [older]),
        build_measured_drive(late_drive(), VEHICLE),
    )
    opened = [whole._replace(is_moving=whole.is_moving & False)]
    mended = make_repair(GapFolder(tmp_path), material, opened, made_kept(), "sha256:0")
    (data, _), _ = ended(verify_repair(GapFolder(tmp_path), material, opened, made_kept(), mended))
    assert len(data["older"]) == 1 and bool(data["worse"]) is not stays
    assert (tmp_path / "model").exists() is stays is ("model" not in data)


def test_an_older_log_that_cannot_judge_says_so(tmp_path: Path) -> None:
    older = late_drive(SECONDS, 9)
    steer = older.fields["report.steer_rad"]
    fields = {**older.fields, "report.gear": 0.0 * steer}
    older = older._replace(name="neutral.log", fields=fields, fresh={**older.fresh, "report.gear": older.enabled})
    material = GapInputs(VEHICLE, made_model(), made_model(), [late_drive()], [older])
    opened = [build_measured_drive(late_drive(), VEHICLE)]
    mended = make_repair(GapFolder(tmp_path), material, opened, made_kept(), "sha256:0")
    (data, _), events = ended(verify_repair(GapFolder(tmp_path), material, opened, made_kept(), mended))
    assert any(one.kind == "warning" and "neutral.log: No block of this log" in one.message for one in events)
    assert data["older"][0]["blocks"] == 0 and (tmp_path / "model").exists()
    told = page_of(tmp_path, {**answer(), **repair_fields(mended), **data})
    assert "## Older log neutral.log\n\nNo block of this log can be simulated" in told
