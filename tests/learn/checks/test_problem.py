"""A refusal names the log as the user gave it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.learn.made_logs import MKZ, checked, rows_of
from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.checks.problem import raise_refusals


def test_the_path_as_it_was_given(tmp_path: Path) -> None:
    back = [row._replace(time_s=row.time_s - (0.5 if row.time_s > 4.0 else 0.0)) for row in rows_of(MKZ, 6.0)]
    problems = checked(tmp_path, MKZ, rows_of(MKZ, 6.0), back)
    with pytest.raises(InputError, match="these logs cannot be used") as caught:
        raise_refusals(problems)
    path = str(tmp_path / "log1.log")
    assert caught.value.file == path and f"  {path}: the clock goes back" in caught.value.message
    (problem,) = [one for one in problems if one.code == "clock_jump"]
    assert (problem.drive, problem.file) == ("log1.log", path)
