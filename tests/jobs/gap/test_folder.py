"""The folder of a gap: an answer that goes further is an answer, and whose question it is is known under the lock."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.gap.made_answer import made_kept
from tunefree_hil.base.errors import InputError
from tunefree_hil.jobs.gap.folder import QUESTION, UNTIL, Folder, held_folder
from tunefree_hil.jobs.run_folder import read_json, write_json
from tunefree_hil.tune import store


@pytest.mark.parametrize("done", UNTIL)
def test_an_answer_that_goes_as_far_is_given_again(done: str, tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    assert folder.answer("locate") is None
    folder.write_answer({"until": done})
    far = UNTIL.index(done)
    assert [folder.answer(until) is not None for until in UNTIL] == [k <= far for k in range(len(UNTIL))]


def test_a_search_for_names_has_located_too(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.keep(made_kept())
    assert folder.search(named=True) == folder.search(named=False) == made_kept()
    folder.keep(made_kept()._replace(named=False))
    assert folder.search(named=True) is None and folder.search(named=False) is not None


def test_whose_question_it_is_is_read_under_the_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lock = store.alone

    @contextmanager
    def later(path: Path) -> Iterator[None]:
        write_json(tmp_path / QUESTION, {"logs": ["another's"]})  # by a process that held it just before
        with lock(path):
            yield

    monkeypatch.setattr(store, "alone", later)
    with pytest.raises(InputError, match="another question: logs"), held_folder(tmp_path, {"logs": ["mine"]}):
        pass
    assert read_json(tmp_path / QUESTION) == {"logs": ["another's"]}
