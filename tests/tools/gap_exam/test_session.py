"""A session of an exam: what is asked, and by whom."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.gap_exam.files import Run, write_json
from tools.gap_exam.prepare import Frozen
from tools.gap_exam.rows import exam_of
from tools.gap_exam.seeds import Domain
from tools.gap_exam.session import Wish, chosen, conduct

COMMIT = "0123456789" * 4


def test_what_is_answered_may_be_counted_from_any_checkout(tmp_path: Path) -> None:
    """Asking is for the exam's own commit."""
    run, exam = Run(tmp_path), exam_of(Domain("exam", COMMIT))
    wish = Wish(tmp_path, rows=("free",), logs=2)
    write_json(run.exam, {"domain": str(exam.domain), "sample": False})
    one, other = chosen(exam, wish)
    write_json(run.answer(one.number) / "run.json", {})
    with pytest.raises(Frozen, match=COMMIT):
        conduct(wish)
    write_json(run.answer(other.number) / "run.json", {})
    assert conduct(wish).cases == exam.cases
