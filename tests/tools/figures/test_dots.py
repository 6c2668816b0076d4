"""Dots: all are there and can be seen, and the sentence counts them right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tools.measures.figures import dots
from tunefree_hil.figures import style

ROWS = {"tuned": [0.31, 0.5, 0.3], "random search": [0.33, 0.35, 0.31], "mrac_on": [0.38], "rule_based": [1.2]}


def test_dots_are_all_there_and_the_sentence_counts_wins() -> None:
    figure = dots.draw_dots(ROWS, "score", "mrac_on")
    assert figure.get_suptitle() == "Tuned beats mrac_on, the best baseline, in 2 of 3 studies (median -18 %)"
    drawn = [line for line in figure.axes[0].lines if line.get_marker() not in ("None", "", None)]
    assert [sorted(np.asarray(line.get_xdata())) for line in drawn] == [sorted(scores) for scores in ROWS.values()]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == list(ROWS)
    assert drawn[0].get_color() == style.TUNED.colour and drawn[2].get_color() == style.MANUAL.colour


@pytest.mark.parametrize("worst", [1.2, 30.0])
def test_every_dot_is_within_the_axis(worst: float) -> None:
    axes = dots.draw_dots({**ROWS, "rule_based": [worst]}, "score", "mrac_on").axes[0]
    assert axes.get_xscale() == ("log" if worst > 6.0 * 0.3 else "linear")
    low, high = axes.get_xlim()
    assert low < 0.3 and high > worst


def test_without_a_line_to_beat_there_is_no_claim() -> None:
    assert dots.draw_dots({"tuned": [0.0, 0.3]}, "score").get_suptitle() == "Scores"


def test_they_are_written_as_a_picture(tmp_path: Path) -> None:
    path = style.save(dots.draw_dots(ROWS, "score", "mrac_on"), tmp_path / "dots.png")
    assert path.read_bytes()[:4] == b"\x89PNG"
