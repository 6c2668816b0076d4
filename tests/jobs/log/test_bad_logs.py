"""At the command line: logs that would teach nonsense end each command with one message, and nothing is written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.learn.checks.test_consistency import swapped
from tests.learn.made_logs import MKZ, PEDALS, VAN, good, negated, planted, rows_of, write_log
from tunefree_hil.bus.formats.rows import Row
from tunefree_hil.cli.entry import run

pytestmark = pytest.mark.learning
Rows = list[Row]


def jumped() -> Rows:
    return [row._replace(time_s=row.time_s - 5.0) if row.time_s > 20.0 else row for row in good(VAN)]


# what is wrong -> (its logs, the commands that must refuse it, what they must say)
BAD: dict[str, tuple[Callable[[], list[Rows]], str, tuple[str, ...]]] = {
    "another vehicle's": (lambda: [list(good(MKZ))], "calibrate learn map collect", ("not one frame of vehicle",)),
    "two vehicles'": (
        lambda: [list(good(VAN)), rows_of(VAN, 30.0, seed=2, ratio=2.0)], "calibrate learn map", ("log1.log",),
    ),
    "too short": (lambda: [rows_of(VAN, 12.0)], "learn map", ("too short", "record more")),
    "steering's sign": (
        lambda: [planted(VAN, good(VAN), negated("steer_rad"), ["report.steer_rad"])], "calibrate learn map",
        ("has the opposite sign of", "change the sign"),
    ),
    "swapped pedals": (
        lambda: [planted(VAN, good(VAN), swapped, PEDALS)], "calibrate learn map", ("swapped pedals; swap them",),
    ),
    "clock": (lambda: [jumped()], "calibrate learn map", ("the clock goes back", "cut the log in two")),
}  # fmt: skip


@pytest.mark.parametrize("wrong", BAD)
def test_a_log_that_teaches_nonsense(wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make, commands, parts = BAD[wrong]
    logs = [str(write_log(tmp_path / f"log{i}.log", rows)) for i, rows in enumerate(make())]
    for command in commands.split():
        given = [word for log in logs for word in ("--from", log)] if command == "collect" else logs
        status = run([command, *given, "--vehicle", VAN, "--out", str(tmp_path / "out"), "--plain"])
        said = capsys.readouterr().err
        assert status == 2 and said.count("error:") == 1 and "what to do:" in said, said
        assert all(part in said for part in parts) and "Traceback" not in said, said
        assert not (tmp_path / "out").exists() and "step 1" not in said
