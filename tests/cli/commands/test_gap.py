"""`gap` hands its options to its job by the agreed names."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tunefree_hil.base.events import Event
from tunefree_hil.cli.entry import run
from tunefree_hil.jobs.gap.options import GapDriveOptions, GapOptions

WORDS = ["a.log", "--vehicle", "v", "--model", "m", "--out", "o"]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The calls that a stand-in for the job gets."""
    heard: list[Any] = []

    def job(asked: GapOptions) -> Iterator[Event]:
        heard.append(asked)
        yield Event("result", "", {"sentence": "steer_lag is missing", "next": ["ls"], "exit": 1})

    stand_in: Any = ModuleType("tunefree_hil.jobs.gap.gap")
    stand_in.run_gap = job
    monkeypatch.setitem(sys.modules, stand_in.__name__, stand_in)
    return heard


def test_logs_and_options_reach_the_job(calls: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["gap", *WORDS]) == 1
    assert run(["gap", "b.log", *WORDS, "--older", "c.log", "--older", "d.log", "--until", "name", "--plain"]) == 1
    assert calls == [
        GapOptions([Path("a.log")], "v", "m", Path("o")),
        GapOptions([Path("b.log"), Path("a.log")], "v", "m", Path("o"), [Path("c.log"), Path("d.log")], "name"),
    ]
    assert capsys.readouterr().err.splitlines()[-1] == "steer_lag is missing"


@pytest.mark.parametrize("words", [["a.log"], WORDS[:-2], [*WORDS, "--until", "all"], WORDS[1:]])
def test_what_is_missing_is_a_usage_mistake(words: list[str], calls: list[Any]) -> None:
    assert run(["gap", *words]) == 2
    assert calls == []


def test_a_bench_reaches_the_drives(calls: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[Any] = []

    def job(asked: GapOptions, wish: GapDriveOptions) -> Iterator[Event]:
        heard.append((asked, wish))
        yield Event("result", "", {"sentence": "steer_lag is missing", "next": []})

    stand_in: Any = ModuleType("tunefree_hil.jobs.gap.drive")
    stand_in.run_gap_with_drives = job
    monkeypatch.setitem(sys.modules, stand_in.__name__, stand_in)
    assert run(["gap", *WORDS, "--drive", "--bench", "b.toml"]) == 0
    assert run(["gap", *WORDS, "--drive", "--bench", "b.toml", "--bus", "virtual"]) == 0
    asked = GapOptions([Path("a.log")], "v", "m", Path("o"))
    assert (
        heard == [(asked, GapDriveOptions(Path("b.toml"), "auto")), (asked, GapDriveOptions(Path("b.toml"), "virtual"))]
        and calls == []
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--drive"], "--drive needs a bench file"),
        (["--bench", "b.toml"], "no meaning without --drive"),
    ],
)
def test_drive_and_bench_come_together(
    words: list[str], said: str, calls: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["gap", *WORDS, *words]) == 2
    assert said in capsys.readouterr().err and calls == []
