"""Drives over more roads than a process keeps: the oldest courses and rows are dropped, and no drive changes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench, write_scenario
from tunefree_hil.bench import Bench, load, parameters_of, simulator
from tunefree_hil.bench.simulator import Job, Simulator

NAMES = ("first", "second", "third", "fourth")


def test_roads_beyond_the_limit_are_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bench(tmp_path, scenarios=NAMES)
    for number, name in enumerate(NAMES):
        write_scenario(tmp_path, name, 0.3 + 0.1 * number)
    monkeypatch.setattr(sys.modules[Bench.__module__], "KEPT_COURSES", 2)
    monkeypatch.setattr(simulator, "KEPT_ROWS", 2)
    bench = load(path)
    made = Simulator(bench)
    jobs = [Job(parameters_of(bench), bench.scenarios[name]) for name in NAMES]
    once = [made.drive(job) for job in jobs]
    again = [made.drive(job) for job in jobs]
    assert [drive.ticks for drive in once] == [30, 40, 50, 60]
    for one, other in zip(once, again, strict=True):
        assert one.recording.columns.keys() == other.recording.columns.keys()
        assert all((one.recording.columns[name] == other.recording.columns[name]).all() for name in ("x_m", "y_m"))
    assert len(made._own.rows) == 2
    courses = [bench.course(bench.scenarios[name]) for name in NAMES]
    assert len(bench.courses) == 2 and bench.course(bench.scenarios[NAMES[3]]) is courses[3]
    assert (
        bench.course(bench.scenarios[NAMES[0]]) == courses[0]
        and bench.course(bench.scenarios[NAMES[0]]) is not courses[0]
    )
