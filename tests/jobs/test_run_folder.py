"""Run folders: found again, refused when foreign, whole or not there."""

import errno
import json

import pytest

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.jobs.run_folder import RunFolder, find_unfinished, open_run, remove_partial_files, write_json


def test_create_open_finish(tmp_path):
    run = RunFolder.create(tmp_path, "drive-a", {"seed": 3})
    assert open_run(run.path).record["complete"] is False
    run.finish(score=1.5)
    again = open_run(run.path)
    assert again.record["complete"] is True and again.record["score"] == 1.5 and again.record["seed"] == 3


def test_two_runs_in_one_second_get_two_folders(tmp_path):
    assert RunFolder.create(tmp_path, "x", {}).path != RunFolder.create(tmp_path, "x", {}).path


def test_unfinished_finds_only_what_agrees(tmp_path):
    done = RunFolder.create(tmp_path, "tune-a", {"hash": "1"})
    done.finish()
    assert find_unfinished(tmp_path, "tune-a", {"hash": "1"}) is None
    other = RunFolder.create(tmp_path, "tune-a", {"hash": "2"})
    mine = RunFolder.create(tmp_path, "tune-a", {"hash": "1"})
    found = [find_unfinished(tmp_path, "tune-a", {"hash": word}) for word in ("1", "2")]
    assert [run.path for run in found if run is not None] == [mine.path, other.path]


def test_a_name_with_brackets_is_found_again(tmp_path):
    for name in ("tune-b[1]", "tune-b*", "tune-b?"):
        made = RunFolder.create(tmp_path, name, {"name": name})
        found = find_unfinished(tmp_path, name, {"name": name})
        assert found is not None and found.path == made.path


def test_a_copy_that_a_person_made_is_no_episode(tmp_path):
    run = RunFolder.create(tmp_path, "drive-a", {})
    for name in ("10", "2", "old", "2 (copy)", "007", "-1"):
        (run.path / "episodes" / name).mkdir()
        (run.path / "episodes" / name / "vehicle.log").write_text("")
    assert run.episodes_with("vehicle.log") == [2, 10] and run.episodes_with("columns.npz") == []


@pytest.mark.parametrize(
    ("record", "key"),
    [
        ({"schema": "tunefree.run/0", "versions": {}}, "schema"),
        ({"schema": "tunefree.run/1", "versions": {"tunefree_hil": "99.0.0"}}, "versions.tunefree_hil"),
        (["not", "a", "record"], "schema"),
    ],
)
def test_of_another_version(tmp_path, record, key):
    write_json(tmp_path / "run.json", record)
    with pytest.raises(InputError) as caught:
        open_run(tmp_path)
    assert caught.value.key == key and "run.json" in caught.value.file


def test_not_a_run(tmp_path):
    with pytest.raises(InputError, match="no such run folder"):
        open_run(tmp_path / "nothing")
    with pytest.raises(InputError, match=r"no run\.json"):
        open_run(tmp_path)
    (tmp_path / "run.json").write_text('{"schema": "tunef')
    with pytest.raises(InputError, match="JSON"):
        open_run(tmp_path)


def test_half_written_files_are_removed(tmp_path):
    run = RunFolder.create(tmp_path, "x", {})
    (run.episode(0) / "vehicle.log.part").write_text("half")
    remove_partial_files(run.path)
    assert list(run.path.rglob("*.part")) == []
    assert json.loads((run.path / "run.json").read_text())["schema"] == "tunefree.run/1"


def test_what_cannot_be_written_says_why_and_what_to_do(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "none" / "x.json", tmp_path / "file" / "x.json"):
        with pytest.raises(BenchError, match=r"cannot write: (No such|Not a dir)") as caught:
            write_json(path, {})
        assert caught.value.hint.startswith("check the folder and its permissions") and caught.value.code == "disk"

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(BenchError, match="cannot write: No space left") as caught:
        write_json(tmp_path / "x.json", {})
    assert caught.value.hint.startswith("free some space") and not list(tmp_path.glob("*.part"))
