"""Numbers of a running job as words."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest

from tunefree_hil.cli import text

FULL = {
    "label": "trial",
    "done": 12,
    "total": 400,
    "eta_s": 7500.0,
    "best": 0.41234,
    "manual": 0.65512,
    "speed_x": 123.4,
    "frames_per_s": 84321.0,
}


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [(0.2, "0 s"), (8.4, "8 s"), (59.6, "1 min 0 s"), (130.0, "2 min 10 s"), (7500.0, "2 h 5 min"), (-3.0, "0 s")],
)
def test_durations(seconds: float, expected: str) -> None:
    assert text.format_duration(seconds) == expected


def test_best_against_manual() -> None:
    assert text.scores_text(FULL) == "best 0.4123, manual 0.6551 (-37 %)"
    assert text.scores_text({"manual": 0.5}) == "manual 0.5"
    assert text.scores_text({"best": 0.5, "manual": 0.0}) == "best 0.5, manual 0"


def test_what_is_not_known_is_not_shown() -> None:
    assert text.format_progress("", {"best": math.nan, "manual": None, "eta_s": math.inf, "done": True}) == ""
    assert text.count_text({"done": 3}) == "3"


def test_one_line_says_all() -> None:
    line = text.format_progress("left_turn", FULL)
    assert line == (
        "trial 12/400; left_turn; best 0.4123, manual 0.6551 (-37 %); 123 x real time, 84,321 frames/s; 2 h 5 min left"
    )


def test_a_next_command_works_as_pasted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "venv" / "bin" / "tunefree-hil"
    program.parent.mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "executable", str(program.parent / "python"))
    monkeypatch.setenv("PATH", "")
    assert text.make_pasteable("tunefree-hil verify runs/x") == "venv/bin/python -m tunefree_hil verify runs/x"
    program.write_text("#!/bin/sh\n")
    assert text.make_pasteable("tunefree-hil verify runs/x") == "venv/bin/tunefree-hil verify runs/x"
    assert text.make_pasteable("candump vcan0") == "candump vcan0"
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent))
    assert text.make_pasteable("tunefree-hil verify runs/x") == "tunefree-hil verify runs/x"
