"""What an exam takes and what is left of it: of a run by what it took, of one that was not begun by what others did."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.tools.gap_exam.drives_for_tests import DOMAIN
from tools.gap_exam.__main__ import main
from tools.gap_exam.catalogue import EFFECTS
from tools.gap_exam.files import Run, write, write_json
from tools.gap_exam.hours import SECONDS, SIDE_BY_SIDE, costs, words
from tools.gap_exam.prepare import begin
from tools.gap_exam.rows import ROUNDS, Exam, exam_of, sample_of

EXAM = exam_of(DOMAIN)


def under_way(folder: Path, exam: Exam, sample: bool = False) -> Run:
    """A run with four one-effect logs answered in 30 s each, their questions made in 6, and a model made in 100."""
    run = Run(folder)
    begin(run, exam, sample=sample)
    for case in [case for case in exam.cases if case.row == "one"][:4]:
        write_json(run.answer(case.number) / "run.json", {"seconds": 30.0, "made_s": 6.0, "status": 0, "words": ""})
    name = next(name for name, model in exam.models.items() if model.kind == "physics")
    write(run.model(name) / "model.toml", "")
    write_json(run.model_time(name), {"seconds": 100.0})
    return run


def test_every_row_and_kind_of_model_has_its_time() -> None:
    some = costs(EXAM)
    assert {one.name for one in some} == set(SECONDS) and not any(one.measured for one in some)
    assert sum(one.count for one in some) == len(EXAM.cases) + len(EXAM.models)
    assert all(one.left == one.count and one.seconds == SECONDS[one.name] for one in some)


def test_all_but_the_last_round_of_the_bisections_fits_in_the_hours_that_an_exam_may_take() -> None:
    """That round is asked last (order.py): without it every effect still has its dozen logs and more."""
    some = {one.name: one for one in costs(EXAM)}
    last = some["limits"].hours / ROUNDS
    assert sum(one.hours for one in some.values()) - last <= 8.0
    without = (some["limits"].count * (ROUNDS - 1) // ROUNDS + some["one"].count) / len(EFFECTS)
    assert without >= 12.0


def test_what_is_left_goes_by_what_it_took(tmp_path: Path) -> None:
    some = {one.name: one for one in costs(EXAM, under_way(tmp_path, EXAM))}
    one, physics, free = some["one"], some["physics"], some["free"]
    assert (one.seconds, one.left, one.measured) == (36.0, one.count - 4, True)
    assert (physics.seconds, physics.left) == (100.0, physics.count - 1)
    assert one.hours_left == pytest.approx((one.count - 4) * 36.0 / 3600.0 / SIDE_BY_SIDE)
    assert not free.measured and free.left == free.count


def test_the_list_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exam = sample_of(DOMAIN)
    under_way(tmp_path, exam, sample=True)
    assert main(["list", "--run", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert said.splitlines()[1].split() == ["one", "24", "20", "36", "0.12", "0.10"]
    assert "24 cases, 4 calibrated and 0 learned models" in said and "not measured" not in said
    assert words(costs(exam)).endswith("* not measured in this run")
