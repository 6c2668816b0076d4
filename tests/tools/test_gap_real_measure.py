"""The measure of what gap says of real cars: pieces dealt out in turn, none twice, refusals told as answers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tools.measures import gap_real
from tools.measures.gap_real import PIECE_S, Halves, pieces, split, told
from tunefree_hil.base.errors import InputError


def a_log(seconds: float) -> str:
    return "".join(f"({100.0 + 0.1 * k:.6f}) can0 123#{k % 256:02X}\n" for k in range(int(10.0 * seconds)))


@pytest.mark.parametrize(("seconds", "many"), [(0.6 * PIECE_S, 1), (1.9 * PIECE_S, 1), (3.2 * PIECE_S, 3)])
def test_a_log_is_cut_into_pieces_that_are_all_of_it(seconds: float, many: int) -> None:
    found = pieces(a_log(seconds))
    assert len(found) == many and "".join(found) == a_log(seconds)
    lengths = [one.count("\n") for one in found]
    assert max(lengths) - min(lengths) <= 1


def test_pieces_go_to_the_model_and_to_the_question_in_turn(tmp_path: Path) -> None:
    logs = []
    for name, seconds in (("long", 3.1 * PIECE_S), ("short", 5.0), ("other", 2.1 * PIECE_S)):
        path = tmp_path / name / "drive.log"
        path.parent.mkdir()
        path.write_text(a_log(seconds))
        logs.append(path)
    halves = split(tmp_path, logs, tmp_path / "cut")
    assert [path.name for path in halves.model] == ["long-0.log", "long-2.log", "other-0.log"]
    assert [path.name for path in halves.asked] == ["long-1.log", "short-0.log", "other-1.log"]
    lines = [sum(path.read_text().count("\n") for path in some) for some in (logs, (*halves.model, *halves.asked))]
    assert lines[0] == lines[1]


def test_a_refusal_is_an_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> Any:
        raise InputError("too short", code="too_short")

    monkeypatch.setattr(gap_real, "calibrate", refuse)
    halves = Halves(tmp_path, (tmp_path / "a.log",), (tmp_path / "b.log",))
    assert gap_real._answer(halves, tmp_path) == {"refused": "too short"}


def test_what_is_told_of_an_answer_is_its_best_and_what_is_broken(tmp_path: Path) -> None:
    signal = {"before": 1.0, "recalibrated": 0.5, "after": None, "floor": 0.1, "unit": "m/s", "unforetold": None}
    answer = {
        "verdict": "none_missing", "sentence": "nothing", "effects": [], "set": [],
        "candidates": [{"name": name, "evidence": by} for name, by in (("a", 1.0), ("b", 4.0), ("c", 2.0), ("d", 3.0))],
        "links": [{"signal": "yaw_rate", "broken": True, "share": 0.2}, {"signal": "steer", "broken": False}],
        "signals": {"report.speed_mps": signal},
    }  # fmt: skip
    found = told(answer, Halves(tmp_path, (), ()))
    assert list(found["evidence"].items()) == [("b", 4.0), ("d", 3.0), ("c", 2.0)]
    assert found["broken"] == {"yaw_rate": 0.2} and found["explained_frac"] is None
    assert found["signals"]["report.speed_mps"] == {"before": 1.0, "recalibrated": 0.5, "after": None, "floor": 0.1}
