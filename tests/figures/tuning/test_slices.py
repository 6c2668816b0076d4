"""Slices of every kind of parameter: a line where values have an order, places side by side where they have none."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.figures.tuning.slices import ParameterSlice, draw_slices

pytest.importorskip("matplotlib")


def test_choices_stand_side_by_side_without_a_line() -> None:
    """The winner may have a value that its slice does not drive again."""
    choices = ParameterSlice([1.0, 7.0], [0.5, None], 2.0, log=False, choices=True)
    steps = ParameterSlice([0.0, 0.5, 1.0], [0.4, 0.5, 9.0], 0.0, log=False)
    figure = draw_slices({"choices": choices, "steps": steps}, best=0.4, manual=0.9, title="slices")
    first, second = figure.axes
    assert [tick.get_text() for tick in first.get_xticklabels()] == ["1", "2", "7"]
    drawn = {line.get_label(): np.asarray(line.get_xdata()).tolist() for line in first.get_lines()}
    assert drawn["winner"] == [1.0] and drawn["winner, one value changed"] == [0.0]
    assert len(second.get_lines()) == len(first.get_lines()) + 1, "the line through the values"


def test_a_logarithmic_choice_is_drawn_by_place() -> None:
    choices = ParameterSlice([0.01, 1.0], [0.5, 0.6], 0.01, log=True, choices=True)
    figure = draw_slices({"choices": choices}, best=0.5, manual=0.9, title="slices")
    assert figure.axes[0].get_xscale() == "linear"
