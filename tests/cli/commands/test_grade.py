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
from tunefree_hil.jobs.grade.grade import GradeOptions

COMPARE = {"fail_if": [], "weights": None, "out": None}


@pytest.mark.parametrize(
    ("words", "module", "function", "arguments", "options"),
    [
        (["grade", "a.log", "--path", "u_turn"], "grade.run", "grade_any", ("a.log", GradeOptions(path="u_turn")), {}),
        (
            ["grade", "a.blf", "--path", "p.csv", "--vehicle", "v", "--align", "start", "--start-s", "2.5"],
            "grade.run",
            "grade_any",
            ("a.blf", GradeOptions(path="p.csv", vehicle="v", align="start", start_s=2.5)),
            {},
        ),
        (["compare", "a", "b"], "grade.compare", "compare", (["a", "b"],), COMPARE),
        (
            [
                "compare",
                "a",
                "b:mrac_on",
                "c",
                "--fail-if",
                "score > +5%",
                "--fail-if",
                "replans > 0",
                "--weights",
                "w",
            ],
            "grade.compare",
            "compare",
            (["a", "b:mrac_on", "c"],),
            {"fail_if": ["score > +5%", "replans > 0"], "weights": "w", "out": None},
        ),
        (["explain", "runs/x"], "tune.explain", "explain", (Path("runs/x"),), {"points": 9, "slices": True}),
        (
            ["explain", "runs/x", "--points", "5", "--no-slices"],
            "tune.explain",
            "explain",
            (Path("runs/x"),),
            {"points": 5, "slices": False},
        ),
    ],
)
def test_options_reach_the_job(
    words: list[str],
    module: str,
    function: str,
    arguments: tuple[Any, ...],
    options: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[tuple[tuple[Any, ...], dict[str, Any]]] = []

    def job(*given: Any, **more: Any) -> Iterator[Event]:
        calls.append((given, more))
        yield Event("result", "", {"sentence": "fine"})

    stand_in = ModuleType(f"tunefree_hil.jobs.{module}")
    setattr(stand_in, function, job)
    monkeypatch.setitem(sys.modules, stand_in.__name__, stand_in)
    assert run(words) == 0
    assert calls == [(arguments, options)]


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
