"""A job's events become lines, one JSON object and an exit status (docs/reference/files.md)."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from tunefree_hil.base.errors import BenchError, InputError, NotValid, PeerGone
from tunefree_hil.base.events import Event
from tunefree_hil.cli.output import PlainSink, make_result_object, present

RESULT = Event("result", "", {"sentence": "done: 3 of 3", "next": ["candump vcan0"], "score": 0.5})


def show(events: Iterable[Event], as_json: bool = False) -> int:
    return present("tune", lambda: events, plain=True, as_json=as_json)


def test_lines_of_a_person(capsys: pytest.CaptureFixture[str]) -> None:
    events = [
        Event("note", "bus: tfhub, because there is no vcan0"),
        Event("warning", "slow"),
        Event("progress", "", {"label": "trial", "done": 1, "total": 3}),
        RESULT,
    ]
    assert show(events) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        "bus: tfhub, because there is no vcan0",
        "warning: slow",
        "trial 1/3",
        "next:",
        "  candump vcan0",
        "done: 3 of 3",
    ]


def test_json_is_the_last_and_only_thing_on_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    assert show([Event("line", "0.0 THROTTLE_CMD"), RESULT], as_json=True) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == {
        "schema": "tunefree.result/1",
        "command": "tune",
        "status": "ok",
        "exit": 0,
        "data": {"sentence": "done: 3 of 3", "next": ["candump vcan0"], "score": 0.5},
        "errors": [],
    }


def test_a_product_goes_to_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    show([Event("line", "0.0 THROTTLE_CMD"), RESULT])
    assert capsys.readouterr().out == "0.0 THROTTLE_CMD\n"


@pytest.mark.parametrize("status", [0, 1, 4])
def test_the_result_gives_the_status(status: int) -> None:
    assert show([Event("result", "over", {"exit": status})]) == status


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (InputError("too many", file="b.toml", key="tune.trials", hint="at most 9"), 2),
        (PeerGone("ecu"), 3),
        (BenchError("refused"), 3),
        (NotValid("late"), 4),
        (FileNotFoundError(2, "No such file or directory", "b.toml"), 2),
        (OSError(28, "No space left on device", "runs/x"), 3),
    ],
)
def test_an_error_is_one_message(error: Exception, status: int, capsys: pytest.CaptureFixture[str]) -> None:
    def job() -> Iterator[Event]:
        yield Event("note", "first")
        raise error

    assert show(job(), as_json=True) == status
    out, err = capsys.readouterr()
    assert "Traceback" not in err
    found = json.loads(out)
    assert (found["status"], found["exit"], len(found["errors"])) == ("failed", status, 1)
    assert set(found["errors"][0]) == {"code", "file", "key", "message", "hint"}


def test_an_error_names_file_key_and_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    def job() -> Iterator[Event]:
        raise InputError("expected at most 9, got 12", file="b.toml", key="tune.trials", hint="lower it")
        yield

    show(job())
    assert capsys.readouterr().err.splitlines() == [
        "error: b.toml, key tune.trials: expected at most 9, got 12",
        "  what to do: lower it",
    ]


def test_a_mistake_of_ours_keeps_its_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    def job() -> Iterator[Event]:
        yield Event("note", str(1 // 0))

    assert show(job()) == 1
    err = capsys.readouterr().err
    assert "Traceback" in err and "ZeroDivisionError" in err.splitlines()[-2]


def test_a_job_without_a_result_failed(capsys: pytest.CaptureFixture[str]) -> None:
    assert show([Event("note", "x")]) == 3
    assert "without a result" in capsys.readouterr().err


def test_interrupted_clears_up_and_says_how_to_go_on(capsys: pytest.CaptureFixture[str]) -> None:
    cleared = []

    def job() -> Iterator[Event]:
        try:
            yield Event("note", "run folder runs/x", {"resume": "candump tune --resume runs/x"})
            raise KeyboardInterrupt
        finally:
            cleared.append(True)

    assert show(job(), as_json=True) == 130
    out, err = capsys.readouterr()
    assert cleared == [True]
    assert err.splitlines()[-3:] == ["next:", "  candump tune --resume runs/x", "interrupted, state saved"]
    found = json.loads(out)
    assert (found["status"], found["exit"]) == ("interrupted", 130)
    assert found["data"] == {"resume": "candump tune --resume runs/x"}


def test_what_only_begins_anew_is_not_said_to_be_saved(capsys: pytest.CaptureFixture[str]) -> None:
    def job(saved: bool) -> Iterator[Event]:
        yield Event("progress", "suspects", {"resume": "candump gap", "saved": False})
        if saved:
            yield Event("note", "proof", {"resume": "candump gap", "saved": True})
        raise KeyboardInterrupt

    ends = []
    for saved in (False, True):
        assert show(job(saved)) == 130
        ends.append(capsys.readouterr().err.splitlines()[-3:])
    text = "interrupted, nothing saved yet: that command starts from the beginning"
    assert ends[0] == ["next:", "  candump gap", text]
    assert ends[1] == ["next:", "  candump gap", "interrupted, state saved"]


def test_interrupted_between_events_clears_up_too(monkeypatch: pytest.MonkeyPatch) -> None:
    cleared = []

    def job() -> Iterator[Event]:
        try:
            yield Event("note", "one")
            yield Event("note", "two")
        finally:
            cleared.append(True)

    def interrupt(sink: PlainSink, event: Event) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(PlainSink, "show", interrupt)
    assert show(job()) == 130
    assert cleared == [True]


def test_nothing_saved_is_not_claimed(capsys: pytest.CaptureFixture[str]) -> None:
    def job() -> Iterator[Event]:
        raise KeyboardInterrupt
        yield

    assert show(job()) == 130
    assert capsys.readouterr().err.splitlines() == ["interrupted"]


class Colour(Enum):
    red = 1


class Point(NamedTuple):
    x_m: float
    y_m: float


def test_json_knows_only_plain_things() -> None:
    data = {
        "nan": math.nan,
        "numpy": np.float64(0.5),
        "row": np.array([1.0, math.inf]),
        "path": Path("runs") / "x",
        "point": Point(1.0, math.nan),
        "colour": Colour.red,
        "exit": 0,
        3: True,
    }
    found = make_result_object("drive", 0, data, [])["data"]
    assert json.loads(json.dumps(found, allow_nan=False)) == {
        "nan": None,
        "numpy": 0.5,
        "row": [1.0, None],
        "path": "runs/x",
        "point": {"x_m": 1.0, "y_m": None},
        "colour": "Colour.red",
        "3": True,
    }


def test_status_and_exit_agree() -> None:
    assert make_result_object("x", 1, {"status": "ok"}, [])["status"] == "failed"
    assert make_result_object("x", 0, {"status": "failed"}, [])["status"] == "ok"
    assert make_result_object("x", 130, {}, [])["status"] == "interrupted"
