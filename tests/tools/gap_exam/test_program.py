"""An exam is of one program, as it was committed: its words and its place are kept, a call of another is refused."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.house import ROOT
from tests.tools.gap_exam.drives_for_tests import DOMAIN
from tools.gap_exam import program as programs
from tools.gap_exam.files import Run, read_json, write_json
from tools.gap_exam.prepare import Frozen, begin, is_frozen
from tools.gap_exam.program import Program, differences, said_of
from tools.gap_exam.rows import exam_of, sample_of
from tools.gap_exam.seeds import Domain

COMMIT = "0123456789" * 4
EXAM = sample_of(DOMAIN)


def script(folder: Path) -> str:
    """A program of an own place that runs."""
    folder.mkdir(exist_ok=True)
    path = folder / "some-gap"
    path.write_text(f"#!{sys.executable}\n")
    path.chmod(0o755)
    return str(path)


def asks(path: str, **more: float) -> Program:
    return Program(gap=f"{path} {{out}}", calibrate=f"{path} {{out}}", learn=f"{path} {{out}}")._replace(**more)


def test_what_is_examined_is_kept_where_the_exam_is_begun(tmp_path: Path) -> None:
    path = script(tmp_path / "a")
    begin(Run(tmp_path), EXAM, program=asks(path))
    said = read_json(Run(tmp_path).exam)["program"]
    assert said["gap"] == f"{path} {{out}}" and said["limit_s"] == 900.0
    one = said["executables"][path]
    assert one["path"] == path and Path(one["package"]) == ROOT / "tunefree_hil" / "__init__.py"
    assert one["version"] and (one["commit"] is None or len(one["commit"]) == 40)
    begin(Run(tmp_path), EXAM, program=asks(path))


def test_other_words_are_refused_with_what_differs_and_what_to_do(tmp_path: Path) -> None:
    path = script(tmp_path / "a")
    begin(Run(tmp_path), EXAM, program=asks(path))
    with pytest.raises(Frozen, match=r"--limit-s was 900\.0, is 60\.0.*another folder") as raised:
        begin(Run(tmp_path), EXAM, program=asks(path, limit_s=60.0))
    assert "--gap" not in str(raised.value), "only what differs"
    with pytest.raises(Frozen, match=r"--gap was .*--learn was "):
        begin(Run(tmp_path), EXAM, program=Program())


def test_an_executable_of_another_place_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same words, and another installation is found first."""
    paths = {"now": script(tmp_path / "a")}
    monkeypatch.setattr(programs, "found", lambda _: paths["now"])
    begin(Run(tmp_path), EXAM, program=asks("some-gap"))
    was, paths["now"] = paths["now"], script(tmp_path / "b")
    with pytest.raises(Frozen, match=rf"some-gap \(path\) was {was}, is {paths['now']}"):
        begin(Run(tmp_path), EXAM, program=asks("some-gap"))


def test_a_package_of_another_place_is_another_program() -> None:
    one = {"path": "/a/bin/gap", "package": "/a/package/__init__.py", "version": "1", "commit": "0"}
    was = {**said_of(Program()), "executables": {"gap": one}}
    moved = {**was, "executables": {"gap": {**one, "package": "/b/package/__init__.py"}}}
    assert differences(was, moved) == ["gap (package) was /a/package/__init__.py, is /b/package/__init__.py"]
    later = {**was, "executables": {"gap": {**one, "commit": "1", "version": "2"}}}
    assert differences(was, later) == [], "development goes on; that a commit is the exam's own is seen elsewhere"


def test_a_program_that_was_not_there_is_not_compared(tmp_path: Path) -> None:
    missing = said_of(Program(gap="no-such-program"))
    assert set(missing["executables"]["no-such-program"].values()) == {None}
    there = {"executables": {"no-such-program": {"path": "/a/b", "package": None}}}
    assert differences(missing, {**missing, **there}) == []


def test_an_exam_begun_before_this_goes_on_with_any_program(tmp_path: Path) -> None:
    begin(Run(tmp_path), EXAM)
    assert "program" not in read_json(Run(tmp_path).exam)
    begin(Run(tmp_path), EXAM, program=Program(limit_s=1.0))
    write_json(Run(tmp_path).exam, {**read_json(Run(tmp_path).exam), "program": said_of(Program())})
    begin(Run(tmp_path), EXAM)


@pytest.mark.slow
def test_an_exam_is_of_a_commit_as_it_was_committed(tmp_path: Path) -> None:
    def git(*words: str) -> str:
        line = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b", *words]
        return subprocess.run(line, check=True, capture_output=True, text=True).stdout.strip()

    git("init", "-q")
    (tmp_path / "a").write_text("1")
    git("add", "a")
    git("commit", "-q", "-m", "one")
    exam = exam_of(Domain("exam", git("rev-parse", "HEAD")), rows=("free",))
    assert is_frozen(exam, tmp_path)
    assert not is_frozen(exam_of(Domain("exam", COMMIT), rows=("free",)), tmp_path)
    assert not is_frozen(exam_of(DOMAIN, rows=("free",)), tmp_path), "development's never is"
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "kept").write_text("1")
    effects = tmp_path / "tunefree_hil" / "effects"
    (effects / "__pycache__").mkdir(parents=True)
    (effects / "__pycache__" / "one.pyc").write_text("1")
    assert is_frozen(exam, tmp_path), "what lies beside the package, and what its interpreter leaves, is no part of it"
    (effects / "new.py").write_text("1")
    assert not is_frozen(exam, tmp_path), "a file more is an effect more in the catalogue"
    (tmp_path / ".git" / "info" / "exclude").write_text("new.py\n")
    assert not is_frozen(exam, tmp_path), "also one that git is told not to see"
    (effects / "new.py").unlink()
    (tmp_path / "a").write_text("2")
    assert not is_frozen(exam, tmp_path)
