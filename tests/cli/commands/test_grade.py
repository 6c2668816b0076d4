"""grade, compare and explain hand their options to their jobs; what is wrong with them ends with status 2."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tunefree_hil.base.events import Event
from tunefree_hil.cli.entry import run
from tunefree_hil.jobs.options.records import CompareOptions, ExplainOptions, GradeOptions


@pytest.mark.parametrize(
    ("words", "module", "function", "arguments"),
    [
        (["grade", "a.log", "--path", "u_turn"], "grade.run", "grade_any", ("a.log", GradeOptions(path="u_turn"))),
        (
            ["grade", "a.blf", "--path", "p.csv", "--vehicle", "v", "--align", "start", "--start-s", "2.5"],
            "grade.run",
            "grade_any",
            ("a.blf", GradeOptions(path="p.csv", vehicle="v", align="start", start_s=2.5)),
        ),
        (["compare", "a", "b"], "grade.compare", "compare", (CompareOptions(["a", "b"]),)),
        (
            [
                *["compare", "a", "b:mrac_on", "c", "--weights", "w"],
                "--fail-if",
                "score > +5%",
                "--fail-if",
                "replans > 0",
            ],
            "grade.compare",
            "compare",
            (CompareOptions(["a", "b:mrac_on", "c"], ["score > +5%", "replans > 0"], "w"),),
        ),
        (["explain", "runs/x"], "tune.explain", "explain", (ExplainOptions(Path("runs/x"), 9, True),)),
        (
            ["explain", "runs/x", "--points", "5", "--no-slices"],
            "tune.explain",
            "explain",
            (ExplainOptions(Path("runs/x"), 5, False),),
        ),
    ],
)
def test_options_reach_the_job(
    words: list[str],
    module: str,
    function: str,
    arguments: tuple[Any, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[tuple[Any, ...]] = []

    def job(*given: Any) -> Iterator[Event]:
        calls.append(given)
        yield Event("result", "", {"sentence": "fine"})

    stand_in = ModuleType(f"tunefree_hil.jobs.{module}")
    setattr(stand_in, function, job)
    monkeypatch.setitem(sys.modules, stand_in.__name__, stand_in)
    assert run(words) == 0
    assert calls == [arguments]


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["grade", "a.log"], "no such file"),
        (["grade", "pyproject.toml"], "--path"),
        (["grade", "nowhere.log", "--path", "u_turn", "--vehicle", "mkz_bywire"], "no such"),
        (["grade", "a.log", "--path", "u_turn", "--align", "somehow"], "--align"),
        (["compare"], "RUN"),
        (["compare", "nowhere"], "at least two runs are needed"),
        (["compare", "nowhere", "either"], "no such run folder"),
        (["explain", "nowhere"], "no such run folder"),
        (["explain", "nowhere", "--points", "1"], "--points"),
    ],
)
def test_what_is_wrong_is_said(words: list[str], part: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(words) == 2
    said = capsys.readouterr().err
    assert part in said and "Traceback" not in said
