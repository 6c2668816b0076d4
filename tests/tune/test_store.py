"""The study file and the lock beside it: wherever the folder is, and whatever is the matter with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.tune.drive_study import bowl, settings
from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.store import exclusive_lock
from tunefree_hil.tune.study import open_study, read_study
from tunefree_hil.tune.trial_loop import run_trials


@pytest.mark.parametrize("name", ["q?a", "pct%20b", "hash#c", "{brace}", "ünï and more"])
def test_a_folder_may_be_called_as_a_person_likes(tmp_path: Path, name: str) -> None:
    path = tmp_path / name / "study.db"
    path.parent.mkdir()
    with open_study(path, settings("random")) as study:
        list(run_trials(study, 1, bowl))
    assert [one.name for one in tmp_path.iterdir()] == [name] and path.is_file()
    with read_study(path) as study:
        assert len(study.trials()) == 1


def test_a_lock_that_cannot_be_had_is_not_taken_for_another_process(tmp_path: Path) -> None:
    for path in (tmp_path / "none" / "worker", tmp_path / "worker"):
        (tmp_path / "worker.lock").write_bytes(b"no lock of ours, but as long as the header of one" * 20)
        with pytest.raises(InputError, match="cannot be locked: ") as caught, exclusive_lock(path):
            pytest.fail("it is not held")
        assert caught.value.code == "study_not_locked" and caught.value.file == str(path.with_suffix(".lock"))
    (tmp_path / "worker.lock").unlink()
    with (
        exclusive_lock(tmp_path / "worker"),
        pytest.raises(InputError, match="another process works on it"),
        exclusive_lock(tmp_path / "worker"),
    ):
        pytest.fail("two hold it")
