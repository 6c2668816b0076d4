"""A repair that closes nothing on the blocks that prove takes its name back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.gap.made_answer import SECONDS, VEHICLE, answer, late_drive, made_kept, made_model
from tests.jobs.ended import ended
from tests.learn.made_drives import CHANNELS, made_drive
from tunefree_hil.gap.chain import open_chain
from tunefree_hil.jobs.gap.folder import Folder
from tunefree_hil.jobs.gap.gap import Asked, Material
from tunefree_hil.jobs.gap.page import write_page
from tunefree_hil.jobs.gap.repair import is_borne_out, mend, proved, taken_back
from tunefree_hil.jobs.gap.words import is_unproved, is_unshown, next_of, sentence_of, waits_for_proof
from tunefree_hil.learn.drives import Drive

WORDS = "steer_dead_time came nearest, and closed nothing of the gap in stretches that no fit has seen"
STEER = "report.steer_rad"
CLOSES = {"value": -0.4, "low": -0.9, "high": 0.1}


def proof_of(drive: Drive, out: Path, *, faint: bool = False, drives: bool = True) -> tuple[dict[str, Any], list[str]]:
    """(keys of gap.json, warnings) of a search that named a later steering. drives: whether the car is in gear."""
    material, opened = Material(VEHICLE, made_model(), [drive], []), [open_chain(drive, VEHICLE)]
    opened = [one._replace(moving=one.moving & drives) for one in opened]
    folder, kept = Folder(out), made_kept()
    named = [{**one, "faint": faint} for one in kept.answer["effects"]]
    kept = kept._replace(answer={**kept.answer, "effects": named})
    mended = mend(folder, material, opened, kept, "sha256:0")
    (data, _), events = ended(proved(folder, material, opened, kept, mended))
    return data, [event.message for event in events if event.kind == "warning"]


def test_a_name_that_closes_the_gap_stays(tmp_path: Path) -> None:
    data, warnings = proof_of(late_drive(), tmp_path)
    assert "taken_back" not in data and data["explained_frac"]["value"] > 0.8 and warnings == []
    assert (tmp_path / "model" / "model.toml").is_file()


def test_a_name_that_closes_nothing_is_taken_back_with_its_model(tmp_path: Path) -> None:
    """The car has no such delay."""
    data, warnings = proof_of(made_drive(SECONDS, seed=5, name="as_modelled.log"), tmp_path)
    assert data["effects"] == [] and data["words"] == [WORDS] and warnings == [f"taken back: {WORDS}"]
    assert data["model"] is None and not (tmp_path / "model").exists()
    assert data["taken_back"]["names"] == ["steer_dead_time"] and data["taken_back"]["explained_frac"]["value"] < 0.0


@pytest.mark.parametrize("faint", [False, True])
def test_where_nothing_can_be_proved_a_faint_name_is_none(tmp_path: Path, faint: bool) -> None:
    data, warnings = proof_of(late_drive(), tmp_path, faint=faint, drives=False)
    assert "no block that was kept for the proof is whole" in warnings[0] and data["explained_frac"] is None
    assert ("taken_back" in data) == faint == (not (tmp_path / "model").exists())
    assert not faint or (data["effects"], data["model"]) == ([], None)


@pytest.mark.parametrize(
    ("broken", "faint", "closes", "says"),
    [
        (True, False, {"value": 0.5, "low": -0.2, "high": 0.9}, True),
        (True, False, CLOSES, False),
        (True, False, {"value": 0.4, "low": 0.2, "high": 0.6}, False),  # a third is left for sure
        (False, False, {"value": 0.5, "low": 0.2, "high": 0.9}, True),
        (
            False,
            False,
            {"value": 0.5, "low": -0.2, "high": 0.9},
            False,
        ),  # the name alone says so
        (False, False, {"value": 0.99, "low": 0.0, "high": 1.0}, True),  # some blocks do not show it
        (False, False, None, True),  # there is no gap to close
        (False, True, {"value": 0.99, "low": 0.0, "high": 1.0}, False),  # and so do not speak for it
        (False, True, {"value": 0.9, "low": 0.5, "high": 1.0}, True),
        (False, True, None, False),
    ],
)
def test_who_is_borne_out(broken: bool, faint: bool, closes: dict[str, float] | None, says: bool) -> None:
    effects = [{"name": "a"}, {"name": "b", "faint": faint}]
    assert is_borne_out({"effects": effects, "links": [{"broken": False}, {"broken": broken}]}, closes) == says


SOME, NONE = {"value": 0.1, "low": -0.9, "high": 0.5}, {"value": 0.0, "low": 0.0, "high": 0.0}


@pytest.mark.parametrize(
    ("evidence", "here", "there", "stirs", "closes", "says"),
    [
        (200.0, 0.6, 0.5, 0.7, SOME, True),  # its own signal says so, row by row
        (200.0, 0.6, 0.2, 0.4, SOME, False),  # it is hardly there
        (200.0, 0.6, 0.5, 0.7, {"value": -0.6, "low": -9.0, "high": 0.0}, False),  # the car is none the better for it
        (200.0, 0.6, 0.001, 0.002, NONE, True),  # these blocks do not show it
        (200.0, 0.6, 0.1, 0.2, NONE, True),  # what recalibration spoilt there was left
        (200.0, 0.6, -0.1, 0.2, {"value": -0.2, "low": -0.5, "high": 0.1}, False),  # they show it, and it spoils them
        (200.0, 0.6, -0.5, 0.9, NONE, False),  # its own signal speaks against it
        (200.0, 0.6, 0.0, 0.6, SOME, False),  # it helps one block and spoils another
        (200.0, 0.6, 0.001, 0.002, {"value": 0.0, "low": -9.0, "high": 0.01}, False),  # one of them goes far astray
        (200.0, -0.3, -0.01, 0.2, SOME, False),  # nowhere of any use
        (200.0, 0.6, None, None, NONE, False),  # those blocks have nothing of its signal
        (40.0, 0.6, 0.5, 0.7, SOME, False),  # not plain
    ],
)
def test_a_plain_name_is_borne_out_by_its_own_signal_as_well(
    evidence: float, here: float, there: float | None, stirs: float | None, closes: dict[str, float], says: bool
) -> None:
    seen = {"shrink": here, "unseen_shrink": there, "unseen_stirs": stirs}
    effects = [{"name": "a", "evidence": evidence, "faint": False, **seen}]
    assert is_borne_out({"effects": effects, "links": [{"broken": True}]}, closes) == says


def test_each_of_several_plain_names_needs_its_own_signals_word() -> None:
    sure = {"evidence": 200.0, "faint": False, "shrink": 0.6, "unseen_shrink": 0.5, "unseen_stirs": 0.7}
    links = [{"broken": True}]
    assert is_borne_out({"effects": [sure, sure], "links": links}, SOME)
    assert not is_borne_out({"effects": [sure, {**sure, "unseen_shrink": 0.01}], "links": links}, SOME)
    assert is_borne_out({"effects": [sure, {**sure, "unseen_shrink": 0.0, "unseen_stirs": 0.0}], "links": links}, SOME)


def test_a_model_that_closes_nothing_is_not_kept_and_that_is_said() -> None:
    one = {**answer(), "explained_frac": {"value": 0.0, "low": 0.0, "high": 0.0}, "worse": []}
    told = sentence_of(one)
    assert "is missing; no model is written" in told and "closes nothing" in told
    assert is_unproved(one) and not is_unproved({**one, "explained_frac": None})


def test_a_model_of_what_the_proof_does_not_show_waits_for_another_drive() -> None:
    shown = {**answer(), "explained_frac": None, "worse": [], "model": "out/model"}
    unseen = {**shown, "effects": [{**shown["effects"][0], "unseen_stirs": 0.0}]}
    assert is_unshown(unseen) and not is_unshown(shown) and not is_unshown({"effects": []})
    for closes, waits in ((None, True), (0.0, True), (0.015, True), (0.4, False)):
        one = {**unseen, "explained_frac": closes and {"value": closes, "low": closes, "high": closes}}
        assert waits_for_proof(one) == waits == ("another drive has to prove the model" in sentence_of(one))
    assert not waits_for_proof({**unseen, "model": None}) and not waits_for_proof(shown)


@pytest.mark.parametrize(("stirs", "stays"), [(0.0, True), (0.99, False)])
def test_a_repair_that_closes_nothing_is_kept_where_those_blocks_do_not_show_it(
    stirs: float, stays: bool, tmp_path: Path
) -> None:
    """It leaves the car as it was, whose own steering is late there: by no delay no gap is closed."""
    kept = made_kept()
    none = {"delay_s": {"value": 0.0, "low": 0.0, "high": 0.0, "unit": "s"}}
    seen = {"unseen_stirs": stirs, "unseen_shrink": 0.0, "params": none}
    named = [{**one, **seen} for one in kept.answer["effects"]]
    kept = kept._replace(answer={**kept.answer, "effects": named}, null={}, repaired={"steer_dead_time.delay_s": 0.0})
    material, opened = Material(VEHICLE, made_model(), [late_drive()], []), [open_chain(late_drive(), VEHICLE)]
    mended = mend(Folder(tmp_path), material, opened, kept, "sha256:0")
    (data, _), _ = ended(proved(Folder(tmp_path), material, opened, kept, mended))
    assert data["explained_frac"]["value"] == pytest.approx(0.0, abs=1e-6) and "taken_back" not in data
    assert ("model" not in data) == stays == (tmp_path / "model" / "model.toml").is_file()
    whole = {**kept.answer, "model": str(tmp_path / "model"), **data, "log_hash": "", "logs": [], "figures": []}
    whole |= {"until": "verify", "model_hash": "", "vehicle_hash": "", "version": ""}
    write_page(tmp_path / "gap.md", {**whole, "sentence": sentence_of(whole)}, [], "again")
    page = (tmp_path / "gap.md").read_text()
    assert ("They do not show what is missing" in page) == stays == ("The repair closes" not in page)


def very_late(later_s: float) -> Drive:
    late = CHANNELS["steer"]._replace(dead_time_s=CHANNELS["steer"].dead_time_s + later_s)
    return made_drive(SECONDS, seed=5, channels={**CHANNELS, "steer": late}, name="late.log")


@pytest.mark.parametrize(("later_s", "verdict"), [(0.0, None), (1.5, "none_of_these")])
def test_what_only_the_blocks_that_prove_miss_grossly_is_not_nothing(
    tmp_path: Path, later_s: float, verdict: str | None
) -> None:
    drive, model = very_late(later_s), made_model()
    material, kept = Material(VEHICLE, model, [drive], []), made_kept("none_missing", words=["nothing", "short"])
    opened = [open_chain(drive, VEHICLE)]
    mended = mend(Folder(tmp_path), material, opened, kept, "sha256:0")
    (data, _), _ = ended(proved(Folder(tmp_path), material, opened, kept, mended))
    assert data.get("verdict") == verdict and list(data.get("missed_in_proof", ()))[:1] == ([STEER] if verdict else [])
    if verdict:
        whole = {**kept.answer, **data}
        assert whole["words"][1:] == ["short"] and f"{STEER} by " in whole["words"][0]
        assert "that the search could not see: the stretches" in sentence_of(whole)
        asked = Asked([Path("a.log")], "car", "model", Path("out"))
        (command,) = next_of(asked, whole, VEHICLE)
        assert "NEXT.log" in command


def test_so_is_a_name_that_was_taken_back(tmp_path: Path) -> None:
    """No link was broken, and of the delay that was named the proof knows nothing."""
    drive = very_late(1.5)
    kept = made_kept()
    unbroken = [{**one, "broken": False} for one in kept.answer["links"]]
    faint = [{**one, "faint": True, "evidence": 20.0} for one in kept.answer["effects"]]
    kept = kept._replace(
        answer={**kept.answer, "links": unbroken, "effects": faint}, repaired={"steer_dead_time.delay_s": 0.0}
    )
    material, opened = Material(VEHICLE, made_model(), [drive], []), [open_chain(drive, VEHICLE)]
    mended = mend(Folder(tmp_path), material, opened, kept, "sha256:0")
    (data, _), _ = ended(proved(Folder(tmp_path), material, opened, kept, mended))
    assert data["taken_back"]["names"] == ["steer_dead_time"] and data["effects"] == [] and data["model"] is None
    assert data["verdict"] == "none_of_these" and next(iter(data["missed_in_proof"])) == STEER


def test_what_is_left_for_sure_is_told() -> None:
    words = taken_back(answer(), {"value": 0.4, "low": 0.2, "high": 0.6}, "physics")["words"][0]
    assert "closed 40 % (20 to 60), which leaves a third and more, of the gap" in words


def test_nothing_to_be_seen_on_the_proof_is_said_of_a_faint_name() -> None:
    found = taken_back(answer(), None, "physics")
    assert found["taken_back"]["explained_frac"] is None and "nothing could be seen of the gap" in found["words"][0]


def test_what_was_closed_is_told_where_that_is_not_sure() -> None:
    words = taken_back(answer(), {"value": 0.5, "low": -0.2, "high": 0.9}, "physics")["words"][0]
    assert words.endswith(
        "closed 50 % (-20 to 90), which is not sure to be any, of the gap in stretches that no fit has seen"
    )


@pytest.mark.parametrize(("broken", "verdict"), [(True, "none_of_these"), (False, "none_missing")])
def test_what_is_said_in_place_of_a_name_that_is_taken_back(broken: bool, verdict: str) -> None:
    one = answer()
    one["links"] = [{**link, "broken": broken} for link in one["links"]]
    now = {**one, **taken_back(one, CLOSES, "physics")}
    assert now["verdict"] == verdict and now["explained_frac"] is None and now["forced"] == "steer_dead_time"
    assert WORDS in sentence_of(now) and now["absorbed"] is False
    assert taken_back(one, CLOSES, "hybrid")["absorbed"], "its net may hide what is not named any more"


def test_the_free_run_of_a_model_that_misses_its_own_logs_tells_nothing() -> None:
    sure = {"evidence": 300.0, "shrink": 0.9, "unseen_shrink": 0.85, "unseen_stirs": 0.9}
    links, usual = [{"broken": True}], ["rate_of_speed"]
    lost = {"value": -1.4, "low": -1.5, "high": -0.8}
    assert not is_borne_out({"effects": [sure], "links": links, "as_usual": []}, lost)
    assert is_borne_out({"effects": [sure], "links": links, "as_usual": usual}, lost)
    silent = {**sure, "unseen_shrink": 0.0, "unseen_stirs": 0.0}  # blocks that do not show it bear nobody out
    for other in ({**sure, "unseen_shrink": 0.4}, {**sure, "evidence": 30.0}, silent):
        assert not is_borne_out({"effects": [sure, other], "links": links, "as_usual": usual}, lost)


def test_where_nothing_is_broken_a_name_that_is_taken_back_leaves_no_place_and_no_change() -> None:
    one = {**answer(), "changes": [{"key": "effects.steer_dead_time.delay_s", "before": None, "after": 0.07}]}
    broken = taken_back(one, CLOSES, "physics")
    assert broken["changes"] == [] and "where" not in broken, "what is missed is missed there all the same"
    one["links"] = [{**link, "broken": False} for link in one["links"]]
    assert taken_back(one, CLOSES, "physics")["where"] == {"link": None, "signal": "", "regime": [], "card": ""}


@pytest.mark.parametrize(("late", "stays"), [(True, True), (False, False)])
def test_older_logs_are_asked_where_nothing_else_can_prove(late: bool, stays: bool, tmp_path: Path) -> None:
    older = late_drive(SECONDS, 9) if late else made_drive(SECONDS, seed=9, name="before.log")
    material, whole = Material(VEHICLE, made_model(), [late_drive()], [older]), open_chain(late_drive(), VEHICLE)
    opened = [whole._replace(moving=whole.moving & False)]
    mended = mend(Folder(tmp_path), material, opened, made_kept(), "sha256:0")
    (data, _), _ = ended(proved(Folder(tmp_path), material, opened, made_kept(), mended))
    assert len(data["older"]) == 1 and bool(data["worse"]) is not stays
    assert (tmp_path / "model").exists() is stays is ("model" not in data)
