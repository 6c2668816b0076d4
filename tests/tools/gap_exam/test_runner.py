"""A model that cannot be made once may be the machine's doing: its cases fail when a second call finds the same."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import pytest

from tests.tools.gap_exam.drives_for_tests import DOMAIN
from tools.gap_exam import runner
from tools.gap_exam.cases import Case
from tools.gap_exam.files import Run, held, read_json, write
from tools.gap_exam.rows import Exam, exam_of
from tools.gap_exam.runner import Examiner, Program

EXAM = exam_of(DOMAIN)
CASES = [case for case in EXAM.cases if case.row == "free"][:2]
MAKES = "import pathlib, sys; p = pathlib.Path(sys.argv[1]); p.mkdir(parents=True); (p / 'model.toml').write_text('')"
ANSWERS = (
    "import pathlib, sys; p = pathlib.Path(sys.argv[1]); p.mkdir(); (p / 'gap.json').write_text('{\"verdict\": 1}')"
)


def asked(folder: Path, calibrate: str, monkeypatch: pytest.MonkeyPatch) -> Examiner:
    """One call over two cases that share nothing but luck."""
    run = Run(folder / "run")

    def question(run: Run, exam: Exam, case: Case) -> tuple[list[Path], Path]:
        write(run.log(case.number), "log")
        return [run.log(case.number)], folder

    monkeypatch.setattr(runner, "question", question)
    monkeypatch.setattr(runner, "vehicle_folder", lambda *_: folder)
    monkeypatch.setattr(runner, "model_logs", lambda *_: [])
    for name, text in (("makes.py", MAKES), ("answers.py", ANSWERS)):
        (folder / name).write_text(text)
    program = Program(gap=f"{sys.executable} {folder / 'answers.py'} {{out}}", calibrate=calibrate)
    examiner = Examiner(run, EXAM, program)
    examiner.go(CASES, 1)
    return examiner


@pytest.mark.slow
def test_a_model_that_fails_is_asked_for_in_the_next_call_and_no_third_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    fails = f"{sys.executable} -c 'import sys; sys.exit(\"no memory\")' {{out}}"
    run = Run(tmp_path / "run")
    first = asked(tmp_path, fails, monkeypatch)
    assert first.unasked == 2 and not any(run.is_answered(case.number) for case in CASES)
    assert "asks for their models once more" in capfd.readouterr().err
    assert not list((tmp_path / "run" / "cases").glob("*/drive.log"))
    again = asked(tmp_path, fails, monkeypatch)
    assert again.unasked == 0 and all(run.is_answered(case.number) for case in CASES)
    assert all("no memory" in read_json(run.answer(case.number) / "run.json")["words"] for case in CASES)


@pytest.mark.slow
def test_a_model_that_failed_once_and_is_made_then_has_its_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked(tmp_path, f"{sys.executable} -c 'import sys; sys.exit(3)' {{out}}", monkeypatch)
    done = asked(tmp_path, f"{sys.executable} {tmp_path / 'makes.py'} {{out}}", monkeypatch)
    assert done.unasked == 0 and len(done.seconds) == 2
    assert all((Run(tmp_path / "run").answer(case.number) / "gap.json").is_file() for case in CASES)


@pytest.mark.slow
def test_what_a_killed_call_left_of_a_model_is_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that is not whole is removed, as commands want a new one; the checkpoint beside it stays."""
    model = Run(tmp_path / "run").model(CASES[0].model)
    part = model.with_name(f"{model.name}.part")
    write(part / "half.npz", "half")
    write(part.with_name(f"{part.name}.part"), "checkpoint")
    asked(tmp_path, f"{sys.executable} {tmp_path / 'makes.py'} {{out}}", monkeypatch)
    assert (model / "model.toml").is_file() and not (model / "half.npz").exists() and not part.exists()
    assert part.with_name(f"{part.name}.part").read_text() == "checkpoint"


@pytest.mark.slow
def test_one_process_at_a_time_makes_a_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another holds it: its folder is not touched, and what it made in the meantime is taken."""
    model = Run(tmp_path / "run").model(CASES[0].model)
    calls: list[str] = []

    def other() -> None:
        with held(model.with_name(f"{model.name}.lock"), lambda: False):
            write(model.with_name(f"{model.name}.part") / "half.npz", "half")
            begun.set()
            time.sleep(1.0)
            calls.append("whole" if (model.with_name(f"{model.name}.part") / "half.npz").is_file() else "taken away")
            write(model / "model.toml", "of the other")

    begun, thread = threading.Event(), threading.Thread(target=other)
    thread.start()
    assert begun.wait(10.0)
    asked(tmp_path, f"{sys.executable} {tmp_path / 'makes.py'} {{out}}", monkeypatch)
    thread.join()
    assert calls == ["whole"] and (model / "model.toml").read_text() == "of the other"


def test_who_gives_up_waiting_does_not_hold(tmp_path: Path) -> None:
    with held(tmp_path / "a.lock", lambda: False) as mine, held(tmp_path / "a.lock", lambda: True) as other:
        assert mine and not other
    with held(tmp_path / "a.lock", lambda: False) as again:
        assert again


@pytest.mark.slow
def test_a_program_that_is_not_there_has_answered_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FileNotFoundError, match="no-such-program"):
        asked(tmp_path, "no-such-program {out}", monkeypatch)
    run = Run(tmp_path / "run")
    assert not any(run.is_answered(case.number) for case in CASES) and not list((tmp_path / "run").rglob("*refused*"))
