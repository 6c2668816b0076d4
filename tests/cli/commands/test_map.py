"""`map` hands its options to its job by the agreed names."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from tunefree_hil.base.events import Event
from tunefree_hil.cli.entry import run
from tunefree_hil.jobs.learn.options import MapOptions


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[MapOptions]:
    """The calls that a stand-in for the job gets."""
    heard: list[MapOptions] = []

    def job(options: MapOptions) -> Iterator[Event]:
        heard.append(options)
        yield Event("result", "", {"sentence": "fine"})

    stand_in = ModuleType("tunefree_hil.jobs.learn.map")
    stand_in.map_logs = job  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, stand_in.__name__, stand_in)
    return heard


def test_logs_vehicle_target_and_seed_reach_the_job(calls: list[MapOptions]) -> None:
    assert run(["map", "a.log", "b.log", "--vehicle", "mkz_bywire", "--out", "c.npz", "--seed", "3", "--plain"]) == 0
    assert run(["map", "a.log", "--vehicle", "mkz_bywire", "--out", "folder"]) == 0
    assert calls == [
        MapOptions([Path("a.log"), Path("b.log")], "mkz_bywire", Path("c.npz"), 3),
        MapOptions([Path("a.log")], "mkz_bywire", Path("folder"), 1),
    ]


@pytest.mark.parametrize("words", [["a.log"], ["a.log", "--vehicle", "x"], ["--vehicle", "x", "--out", "y"]])
def test_what_is_missing_is_a_usage_mistake(words: list[str], calls: list[MapOptions]) -> None:
    assert run(["map", *words]) == 2
    assert calls == []
