"""The two lines that stay in place, drawn on a recorded terminal of 80 columns."""

from __future__ import annotations

import io
import re

import pytest
from rich.console import Console

from tunefree_hil.base.events import Event
from tunefree_hil.cli.live import REDRAW_S, LiveSink, render_progress
from tunefree_hil.cli.output import _make_sink

DATA = {
    "label": "trial",
    "done": 12,
    "total": 40,
    "eta_s": 130.0,
    "best": 0.41234,
    "manual": 0.65512,
    "speed_x": 12.3,
    "frames_per_s": 4300.0,
}


def terminal(width: int = 80, no_color: bool = False) -> Console:
    return Console(file=io.StringIO(), force_terminal=True, width=width, no_color=no_color, color_system="standard")


def drawn(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_two_lines_fit_80_columns() -> None:
    console = Console(file=io.StringIO(), width=80)
    console.print(render_progress("left_turn", DATA))
    lines = drawn(console).splitlines()
    assert len(lines) == 2
    assert all(len(line) <= 80 for line in lines)
    assert "trial 12/40" in lines[0] and "2 min 10 s left" in lines[0]
    assert lines[1].startswith("best 0.4123, manual 0.6551 (-37 %), 12.3 x real time, 4,300 frames/s")


def test_a_block_stays_below_the_two_lines_and_is_cut_not_wrapped() -> None:
    console = Console(file=io.StringIO(), width=80)
    console.print(render_progress("drive", {**DATA, "block": ["first row", "x" * 100]}))
    lines = drawn(console).splitlines()
    assert len(lines) == 4 and lines[2].rstrip() == "first row" and len(lines[3]) == 80


def test_a_narrow_terminal_cuts_and_does_not_wrap() -> None:
    console = Console(file=io.StringIO(), width=60)
    console.print(render_progress("left_turn", DATA))
    assert len(drawn(console).splitlines()) == 2


def test_no_color_draws_none() -> None:
    console = terminal(no_color=True)
    sink = LiveSink(console)
    sink.show(Event("warning", "slow"))
    sink.show(Event("progress", "", DATA))
    sink.close()
    colours = re.findall(r"\x1b\[[0-9;]*m", drawn(console))
    assert not [code for code in colours if re.search(r"\b[34]\d\b", code)]


def test_redraws_are_limited_but_the_last_is_drawn() -> None:
    console, now_s = terminal(), [0.0]
    sink = LiveSink(console, lambda: now_s[0])
    counts = []
    for done in range(1, 41):
        now_s[0] += REDRAW_S / 10.0
        sink.show(Event("progress", "", {**DATA, "done": done}))
        counts.append(drawn(console).count("trial"))
    sink.close()
    assert counts[-1] <= 6
    assert "trial 40/40" in drawn(console)


def test_what_was_done_stays_on_the_screen() -> None:
    console, now_s = terminal(), [0.0]
    sink = LiveSink(console, lambda: now_s[0])
    for done in (1, 1, 2):
        sink.show(Event("progress", f"trial {done} scored 0.{done}", {**DATA, "done": done}))
    sink.close()
    assert drawn(console).count("trial 1 scored 0.1") == 1
    assert drawn(console).count("trial 2 scored 0.2") == 1


def test_a_long_command_is_not_broken() -> None:
    console = terminal()
    LiveSink(console).show(Event("note", "x" * 200))
    assert "x" * 200 in drawn(console)


def test_lines_where_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    assert type(_make_sink(False)).__name__ == "PlainSink"
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "dumb")
    assert type(_make_sink(False)).__name__ == "PlainSink"
    monkeypatch.setenv("TERM", "xterm-256color")
    assert type(_make_sink(False)).__name__ == "LiveSink"
    assert type(_make_sink(True)).__name__ == "PlainSink"
