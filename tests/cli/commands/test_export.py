"""`export` hands its options to its job by the agreed names."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from tunefree_hil.base.events import Event
from tunefree_hil.cli.entry import run
from tunefree_hil.jobs.options.records import ExportOptions


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[ExportOptions]:
    """The calls that a stand-in for the job gets."""
    got: list[ExportOptions] = []

    def job(options: ExportOptions) -> Iterator[Event]:
        got.append(options)
        yield Event("result", "", {"sentence": "fine"})

    stand_in = ModuleType("tunefree_hil.jobs.export.export")
    stand_in.export = job  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, stand_in.__name__, stand_in)
    return got


def test_source_target_folder_and_set_reach_the_job(calls: list[ExportOptions]) -> None:
    assert run(["export", "runs/x", "--to", "apollo", "--out", "there"]) == 0
    assert run(["export", "b.toml", "--to", "autoware", "--out", "there", "--set", "mrac_on", "--plain"]) == 0
    assert calls == [
        ExportOptions(Path("runs/x"), "apollo", Path("there")),
        ExportOptions(Path("b.toml"), "autoware", Path("there"), "mrac_on"),
    ]


@pytest.mark.parametrize("words", [["runs/x"], ["runs/x", "--to", "ros", "--out", "y"], ["--to", "apollo"]])
def test_what_is_missing_is_a_usage_mistake(words: list[str], calls: list[ExportOptions]) -> None:
    assert run(["export", *words]) == 2
    assert calls == []
