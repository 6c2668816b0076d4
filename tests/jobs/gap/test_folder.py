"""The folder of a gap: an answer that goes further is an answer, and whose question it is is known under the lock."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

import tunefree_hil.effects
from tests.gap.made_answer import VEHICLE, made_kept, made_model
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import EffectSpec
from tunefree_hil.gap.result import as_json
from tunefree_hil.jobs.gap.folder import (
    ANSWER,
    ANSWER_SCHEMA,
    QUESTION,
    SEARCH,
    STEPS,
    GapFolder,
    lock_folder,
    question_record,
)
from tunefree_hil.jobs.run_folder import read_json, write_json
from tunefree_hil.tune import store


def said(folder: Path, **more: Any) -> dict[str, Any]:
    """An answer as a run in that folder writes it."""
    figures = [str(folder / "figures" / "where.png")]
    return {
        "schema": ANSWER_SCHEMA, "until": "verify", "verdict": "one", "sentence": "", "model": None, "figures": figures,
        **more,
    }  # fmt: skip


@pytest.mark.parametrize("done", STEPS)
def test_an_answer_that_goes_as_far_is_given_again(done: str, tmp_path: Path) -> None:
    folder = GapFolder(tmp_path)
    assert folder.load_answer("locate") is None
    folder.write_answer(said(tmp_path, until=done))
    far = STEPS.index(done)
    assert [folder.load_answer(until) is not None for until in STEPS] == [k <= far for k in range(len(STEPS))]


def test_a_search_for_names_has_located_too(tmp_path: Path) -> None:
    folder = GapFolder(tmp_path)
    folder.store_search(made_kept())
    assert folder.load_search(named=True) == folder.load_search(named=False) == made_kept()
    folder.store_search(made_kept()._replace(has_candidates=False))
    assert folder.load_search(named=True) is None and folder.load_search(named=False) is not None


def test_whose_question_it_is_is_read_under_the_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lock = store.exclusive_lock

    @contextmanager
    def later(path: Path) -> Iterator[None]:
        write_json(tmp_path / QUESTION, {"logs": ["another's"]})  # by a process that held it just before
        write_json(tmp_path / SEARCH, {})
        with lock(path):
            yield

    monkeypatch.setattr(store, "exclusive_lock", later)
    with pytest.raises(InputError, match="another question: logs"), lock_folder(tmp_path, {"logs": ["mine"]}):
        pass
    assert read_json(tmp_path / QUESTION) == {"logs": ["another's"]}


def test_a_question_that_came_to_nothing_leaves_room_for_another(tmp_path: Path) -> None:
    with lock_folder(tmp_path, {"model": "with a mistake"}):
        pass
    with lock_folder(tmp_path, {"model": "mended"}) as folder:
        folder.store_search(made_kept())
    assert read_json(tmp_path / QUESTION) == {"model": "mended"}
    with pytest.raises(InputError, match="another question: model"), lock_folder(tmp_path, {"model": "a third"}):
        pass


def test_another_card_is_another_question(tmp_path: Path) -> None:
    model = replace(made_model(), folder=str(tmp_path))
    with_card = replace(model, plant=replace(model.plant, card="card.json"))
    asked = []
    for text in ("{}", '{"own_logs_asked": true}'):
        (tmp_path / "card.json").write_text(text)
        asked.append(question_record([], [], VEHICLE, with_card))
    none = question_record([], [], VEHICLE, model)
    assert asked[0]["card"] != asked[1]["card"] and "card" not in none
    out = tmp_path / "out"
    with lock_folder(out, asked[0]) as folder:
        folder.store_search(made_kept())
    for other in (asked[1], none):
        with pytest.raises(InputError, match="another question: card differs"), lock_folder(out, other):
            pass


def test_an_effect_more_is_another_question(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text("EFFECT = 1")
    model = replace(made_model(), effects=[EffectSpec(name=f"{mine}:EFFECT", params={})])
    first = question_record([], [], VEHICLE, model)
    assert question_record([], [], VEHICLE, model) == first
    mine.write_text("EFFECT = 2")
    second = question_record([], [], VEHICLE, model)
    assert {key for key in first if first[key] != second[key]} == {"effects"}
    (tmp_path / "effects").mkdir()
    for name in ("__init__.py", "one.py"):
        (tmp_path / "effects" / name).write_text("")
    monkeypatch.setattr(tunefree_hil.effects, "__file__", str(tmp_path / "effects" / "__init__.py"))
    before = question_record([], [], VEHICLE, model)
    (tmp_path / "effects" / "mine.py").write_text("")
    assert question_record([], [], VEHICLE, model)["effects"] != before["effects"]


def test_an_answer_says_where_its_files_are_now(tmp_path: Path) -> None:
    before, now = tmp_path / "k3", tmp_path / "k4"
    for place in ("round-2/model", "figures", "round-2/figures", "drives/logs"):
        (before / place).mkdir(parents=True)
    (before / "round-2" / "figures" / "shrink.png").touch()
    figures = [str(before / one) for one in ("figures/where.png", "round-2/figures/shrink.png")]
    drives = [{"log": str(before / "drives" / "logs" / "drive-001.log")}]
    GapFolder(before).write_answer(said(before, model=str(before / "round-2/model"), figures=figures, drives=drives))
    assert GapFolder(before).load_answer("verify") == read_json(before / ANSWER)
    before.rename(now)
    found = GapFolder(now).load_answer("verify")
    assert found is not None and found["model"] == str(now / "round-2" / "model")
    assert found["figures"] == [str(now / "figures" / "where.png"), str(now / "round-2" / "figures" / "shrink.png")]
    assert found["drives"] == [{"log": str(now / "drives" / "logs" / "drive-001.log")}]


@pytest.mark.parametrize("text", ["", "{}", "no json", "[1]", "half"])
def test_what_is_no_answer_and_no_search_is_not_there(text: str, tmp_path: Path) -> None:
    folder = GapFolder(tmp_path)
    folder.store_search(made_kept())
    search = {key: one for key, one in as_json(made_kept()).items() if key != "shape"}
    (tmp_path / SEARCH).write_text(json.dumps(search) if text == "half" else text)
    half = json.dumps({"schema": ANSWER_SCHEMA, "until": "verify"})
    (tmp_path / ANSWER).write_text(half if text == "half" else text)
    assert folder.load_answer("locate") is None and folder.load_search(named=False) is None
