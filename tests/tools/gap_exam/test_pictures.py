"""What the pictures say: every outcome, whose exam it is, intervals, and limits within what was asked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tools.gap_exam import pictures
from tools.gap_exam.limits import Limit
from tools.gap_exam.outcomes import OUTCOMES
from tools.gap_exam.pictures import draw_limits, draw_outcomes, heading
from tools.gap_exam.score import Row
from tools.gap_exam.statistics import share
from tools.gap_exam.words import limit_words


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The figure that was drawn last, left open until the test is over."""
    plt = pictures._plotter()
    close = plt.close
    monkeypatch.setattr(plt, "close", lambda _: None)
    yield plt.gcf
    close("all")


def words_of(axes: Any) -> list[str]:
    return [one.get_text() for one in axes.texts]


def test_a_picture_says_which_exam_and_how_many_logs() -> None:
    commit = "0123456789" * 4
    assert heading(f"exam:{commit}", ["5 of 9 done"]) == "Exam of commit 012345678901; logs: 5 of 9 done"
    both = heading(f"exam:{commit} and dev:a", ["5 of 9 done", "12 of 1281 done"])
    assert both == "2 exams (0123456, dev:a); logs: 17"
    assert heading("dev:a (not frozen)", []) == "Exam of dev:a (not frozen)"


def test_outcomes_are_all_in_the_legend_and_intervals_beside_the_bars(tmp_path: Path, drawn: Any) -> None:
    counts = {**dict.fromkeys(OUTCOMES, 0), "right": 7, "failed": 2, "cannot_test": 1}
    rows = [
        Row("free", 10, counts, {"right": share(7, 10), "wrong": share(0, 10)}, 4, True),
        Row("x", 10, counts, {}, 1),
    ]
    draw_outcomes(tmp_path / "a.png", rows, "Exam of commit x; logs: 20")
    figure = drawn()
    axes, beside = figure.axes
    legend = [one.get_text() for one in axes.get_legend().get_texts()]
    assert legend == [name.replace("_", " ") for name in OUTCOMES]
    assert figure.get_suptitle() == "Exam of commit x; logs: 20"
    assert "70 (39.7 to 89.2)" in words_of(beside) and "0 (0 to 27.8)" in words_of(beside)
    assert [one.get_text() for one in axes.get_yticklabels()] == ["free (10 logs, 4 models*)", "x (10 logs, 1 model)"]


def limit(low: float | None, high: float | None, value: float | None = 11e3) -> Limit:
    steps = ((0.3, 25e3, 1, 3), (0.9, 9e3, 3, 3))
    return Limit("power_limit", value, low, high, "W", 6, (0.78, 0.3, 0.9), steps)


def ends(axes: Any) -> dict[str, list[float]]:
    """Places of the arrows, and of the ends of the thin line."""
    found: dict[str, list[float]] = {}
    for line in axes.lines:
        if len(line.get_xdata()) and line.get_marker() in ("<", ">"):
            found[line.get_marker()] = list(line.get_xdata())
        elif len(line.get_xdata()) == 2 and line.get_linewidth() < 1.0:
            found["line"] = list(line.get_xdata())
    return found


def test_an_open_end_is_an_arrow_at_the_size_asked(tmp_path: Path, drawn: Any) -> None:
    draw_limits(tmp_path / "a.png", [limit(None, None)], "x")
    both = ends(drawn().axes[0])
    assert both["line"] == [0.3, 0.9]
    assert both["<"][0] == pytest.approx(0.3, abs=0.03) and both[">"][0] == pytest.approx(0.9, abs=0.03)
    draw_limits(tmp_path / "b.png", [limit(20e3, 9.5e3)], "x")
    assert set(ends(drawn().axes[0])) == {"line"}
    draw_limits(tmp_path / "c.png", [limit(None, None, value=None)], "x")
    assert set(ends(drawn().axes[0])) == {"line", ">"}, "what is never named is open upwards alone"


def test_the_limits_say_what_their_marks_are_and_which_way_is_grosser(tmp_path: Path, drawn: Any) -> None:
    one = limit(20e3, 9.5e3)
    draw_limits(tmp_path / "a.png", [one], "x")
    axes, beside = drawn().axes
    legend = " ".join(text.get_text() for text in axes.get_legend().get_texts())
    assert all(word in legend for word in ("named in 90 %", "95 % interval", "open", "none of them"))
    assert words_of(beside) == [limit_words(one)] == ["11 000 W (20 000 to 9 500)"]
    assert axes.get_yticklabels()[0].get_text() == "power_limit ↓" and "↓: the smaller" in axes.get_xlabel()
