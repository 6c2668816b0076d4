"""Logs of one call against each other: one file that is named twice, and a copy of it."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.learn.made_logs import MKZ, car, good, refusals, write_log
from tunefree_hil.learn.check_pair import check_same_vehicle
from tunefree_hil.learn.read import read_drives


def test_a_file_named_twice_is_refused_and_a_copy_told(tmp_path: Path) -> None:
    """By whatever path; a copy under another name is held out together with what it is a copy of."""
    log = write_log(tmp_path / "a.log", good(MKZ))
    (tmp_path / "link.log").symlink_to(log)
    for again in (log, tmp_path / "link.log"):
        found = refusals(list(check_same_vehicle(read_drives([log, again], car(MKZ).codec))))
        assert found.keys() == {"twice"} and f"{again} is named twice" in found["twice"].words
    copy = Path(shutil.copy(log, tmp_path / "copy.log"))
    (told,) = check_same_vehicle(read_drives([log, copy], car(MKZ).codec))
    assert (told.severity, told.code) == ("warn", "twice") and f"{copy} is the same recording as {log}" in told.words
