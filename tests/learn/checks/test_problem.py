"""A refusal names the log as it was given, and says no more than that nothing is done."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.learn.made_logs import MKZ, checked, rows_of
from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.checks.problem import require_good


def test_the_path_as_it_was_given(tmp_path: Path) -> None:
    back = [row._replace(time_s=row.time_s - (0.5 if row.time_s > 4.0 else 0.0)) for row in rows_of(MKZ, 6.0)]
    found = checked(tmp_path, MKZ, rows_of(MKZ, 6.0), back)
    with pytest.raises(InputError, match="nothing is done with these logs") as caught:
        require_good(found)
    path = str(tmp_path / "log1.log")
    assert caught.value.file == path and f"  {path}: the clock goes back" in caught.value.message
    (one,) = [one for one in found if one.code == "clock_jump"]
    assert (one.drive, one.file) == ("log1.log", path)
