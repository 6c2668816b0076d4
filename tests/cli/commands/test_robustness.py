"""robustness hands its options to its job; what is wrong with them ends with status 2."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from tunefree_hil.base.events import Event
from tunefree_hil.cli.entry import run
from tunefree_hil.jobs.robustness.options import RobustnessOptions

WORDS = ["--roads", "families:50", "--public", "--seed", "3", "--cars", "9", "--model", "m", "--allowed", "2"]
WORDS += ["--scheduler", "tcp://h:1", "--out", "o"]


def test_options_reach_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[RobustnessOptions] = []

    def job(options: RobustnessOptions) -> Iterator[Event]:
        calls.append(options)
        yield Event("result", "", {"sentence": "fine"})

    stand_in = ModuleType("tunefree_hil.jobs.robustness.sweep")
    stand_in.sweep_roads = job  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, stand_in.__name__, stand_in)
    assert run(["robustness", "runs/x"]) == 0 and run(["robustness", "runs/x", *WORDS]) == 0
    whole = RobustnessOptions(Path("runs/x"), "families:50", True, 3, 9, "m", 2, "tcp://h:1", Path("o"))
    assert calls == [RobustnessOptions(Path("runs/x")), whole]


@pytest.mark.parametrize(
    ("words", "part"),
    [
        ([], "RUN"),
        (["nowhere"], "no such run folder"),
        (["nowhere", "--cars", "1"], "--cars"),
        (["nowhere", "--cars", "65"], "--cars"),
        (["nowhere", "--allowed", "-1"], "--allowed"),
        (["nowhere", "--scheduler", "somewhere"], "no address of a scheduler"),
    ],
)
def test_what_is_wrong_is_said(words: list[str], part: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["robustness", *words]) == 2
    said = capsys.readouterr().err
    assert part in said and "Traceback" not in said
