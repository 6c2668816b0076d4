"""The measures of the exam of `gap`: they go on with a run, say how far it is, and make no number out of nothing."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Any

import pytest

from tools.gap_exam.beside import Beside, chosen
from tools.gap_exam.files import Run, read_json, write_json
from tools.gap_exam.prepare import begin
from tools.gap_exam.rows import exam_of
from tools.gap_exam.runner import Program
from tools.gap_exam.seal import put_away
from tools.gap_exam.seeds import Domain
from tools.gap_exam.session import exam_for
from tools.measures import _gap_exam, gap_exam, gap_limits, gap_sample, gap_time
from tunefree_hil.base.errors import InputError

DOMAIN = Domain("dev", "measures")
SAYS = "import pathlib, sys; p = pathlib.Path(sys.argv[-1]); p.mkdir(); "
MODEL = f"{sys.executable} -c \"{SAYS}(p / 'model.toml').write_text('')\" {{out}}"
NAMES = f"{sys.executable} -c \"{SAYS}(p / 'gap.json').write_text('{{}}')\" {{out}}"


def answer(run: Run, case: Any, *names: str, detectable: bool = True, **more: Any) -> None:
    """An answered case."""
    oracle = {"detectable": detectable}
    put_away(run, case.number, {**case._asdict(), "oracle": oracle, "mismatch": 0.0, **more}, "00")
    effects = [{"name": name, "params": {}} for name in names]
    data = {"verdict": "one" if names else "none_missing", "effects": effects, "set": []}
    write_json(run.answer(case.number) / "gap.json", data)
    write_json(run.answer(case.number) / "run.json", {"seconds": 2.0, "status": 0, "words": ""})


def _compared(run: Run, exam: Any, cases: Any, logs: int) -> None:
    """In the place of the comparison with a network, which takes its minutes."""
    for one in chosen(cases, logs):
        write_json(run.folder / "beside" / f"{one.number:04d}.json", Beside(0.9, 0.6, 0.9, 0.1, 0.8, 0.01)._asdict())


@pytest.fixture
def begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """A run of which ten one-effect logs are answered: of eight detectable ones six right, one silent, one wrong."""
    for module in (gap_exam, gap_limits, gap_sample, gap_time):
        monkeypatch.setattr(module, "there_is_gap", lambda: None)
    monkeypatch.setattr(_gap_exam, "conduct", exam_for)
    monkeypatch.setattr(_gap_exam, "compare_all", _compared)
    run, exam = Run(tmp_path / "run"), exam_of(DOMAIN)
    begin(run, exam)
    cases = [case for case in exam.cases if case.row == "one"][:10]
    for k, case in enumerate(cases):
        name = next(iter(case.effects))
        answer(run, case, *([name] if k < 6 else ["payload" if name != "payload" else "grade"] if k == 7 else []),
               detectable=k < 8)  # fmt: skip
    return run


def test_the_value_is_of_detectable_logs_and_says_how_many(begun: Run, capsys: pytest.CaptureFixture[str]) -> None:
    found = gap_exam.measure(run=str(begun.folder))
    assert found["value"] == pytest.approx(75.0) and found["n"] == 8 and found["unit"] == "percent"
    assert 40.0 < found["low"] < 75.0 < found["high"] < 94.0
    detail = found["detail"]
    assert detail["exams"][0]["done"] == "10 of 1281 done" and not detail["exams"][0]["whole"]
    assert detail["exams"][0]["rows_done"]["free"] == "0 of 300"
    assert len(detail["exams"][0]["truths"]) == 64 and detail["exams"][0]["domain"] == "dev:measures"
    row = detail["rows"]["one effect, beside a plain LSTM residual"]
    assert row["n"] == 8 and row["figures"]["name_over_net_same"]["value"] == pytest.approx(1.5)
    assert len(detail["wrong"]) == 1 and detail["rows"]["one effect, not detectable"]["n"] == 2
    assert "10 of 1281 done, not the whole exam" in capsys.readouterr().err
    assert (begun.folder / "table.md").is_file()


def test_limits_are_of_the_same_run(begun: Run) -> None:
    with pytest.raises(InputError, match="no log of it is answered yet"):
        gap_limits.measure(run=str(begun.folder))
    steps = [case for case in exam_of(DOMAIN).cases if case.rung >= 0 and list(case.effects) == ["steer_dead_time"]]
    for k, case in enumerate(steps[:6]):
        answer(begun, case._replace(size=0.5 if k < 3 else 0.25), *(["steer_dead_time"] if k < 3 else []))
    found = gap_limits.measure(run=str(begun.folder))
    assert found["unit"] == "ms" and found["n"] == 6 and 20.0 < found["value"] < 80.0
    assert found["high"] is None, "nothing was asked beyond: open"
    assert found["detail"]["limits"]["steer_dead_time"]["words"].endswith(" to open)")
    assert "10 of 294" in found["detail"]["exams"][0]["rows_done"]["one"]


def test_nothing_answered_is_no_number(begun: Run, tmp_path: Path) -> None:
    other = Run(tmp_path / "other")
    begin(other, exam_of(DOMAIN))
    with pytest.raises(InputError, match="0 of 1281 done"):
        gap_exam.measure(run=str(other.folder))


def test_later_exams_are_pooled(begun: Run, tmp_path: Path) -> None:
    later, exam = Run(tmp_path / "later"), exam_of(Domain("dev", "later"))
    begin(later, exam)
    case = next(case for case in exam.cases if case.row == "one")
    answer(later, case, next(iter(case.effects)))
    found = gap_exam.measure(run=str(begun.folder), pool=str(later.folder))
    assert found["n"] == 9 and found["value"] == pytest.approx(100.0 * 7 / 9, abs=0.01)
    assert [one["domain"] for one in found["detail"]["exams"]] == ["dev:measures", "dev:later"]


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_a_run_is_begun_gone_on_with_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log with a program that says nothing of use, then one more; nothing is asked twice."""
    monkeypatch.setattr(gap_sample, "there_is_gap", lambda: None)
    conduct = _gap_exam.conduct
    program = Program(gap=NAMES, calibrate=MODEL)
    monkeypatch.setattr(_gap_exam, "conduct", lambda wish: conduct(wish._replace(program=program)))
    options = {"run": str(tmp_path / "run"), "domain": str(DOMAIN)}
    for logs in (1, 2):
        with contextlib.suppress(InputError):  # where none of so few is detectable there is no number
            gap_sample.measure(logs=logs, **options)
        assert len(list((tmp_path / "run" / "answers").glob("*/run.json"))) == logs
    run = Run(tmp_path / "run")
    assert read_json(run.exam)["sample"] and not read_json(run.exam)["frozen"]
    assert read_json(next((run.folder / "answers").glob("*/run.json")))["status"] == 0


def test_the_time_of_a_long_log_is_that_of_whole_answers(begun: Run, tmp_path: Path) -> None:
    run, exam = Run(tmp_path / "long"), gap_time.long_logs(2)
    assert [case.duration_s for case in exam.cases] == [600.0, 600.0]
    for case in exam.cases:
        answer(run, case, "payload")
    found = gap_time.measure(str(run.folder), 2)
    assert (found["value"], found["n"], found["low"], found["high"]) == (2.0, 2, 2.0, 2.0)
    (run.answer(exam.cases[0].number) / "gap.json").unlink()
    with pytest.raises(InputError, match="no answer"):
        gap_time.measure(str(run.folder), 2)
