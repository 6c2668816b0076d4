"""The figures of a road sweep: every road is a mark in its state, every share its numbers, and nothing is cut off."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.text import Text

from tunefree_hil.figures.robustness import (
    AXES,
    LEAST_CURVATURE_1PM,
    STATES,
    RoadPoint,
    ShareBar,
    draw_failure_map,
    draw_failure_shares,
)

PASSED, MISSED, LOST, UNDRIVABLE = STATES
POINTS = [
    RoadPoint(10.0, 2.0, 1.0, 0.02, {"tuned": PASSED, "manual (a)": PASSED}),
    RoadPoint(20.0, 0.0, 3.0, 0.0, {"tuned": PASSED, "manual (a)": LOST}),
    RoadPoint(5.0, 1.0, 0.5, 0.04, {"tuned": MISSED, "manual (a)": LOST}),
    RoadPoint(25.0, 1.5, 2.5, 0.003, {"tuned": UNDRIVABLE, "manual (a)": UNDRIVABLE}),
]


def is_tick(text: Text) -> bool:
    """A number at an axis; those beyond its end are there but not drawn."""
    digits = text.get_text().replace("\N{MINUS SIGN}", "").replace(".", "")
    return digits.isdigit() or digits.startswith("$")


def marks_of(axes: Axes) -> np.ndarray:
    return np.concatenate(
        [np.asarray(one.get_offsets()) for one in axes.collections if isinstance(one, PathCollection)]
    )


def texts(figure: Figure) -> list[str]:
    figure.canvas.draw()
    inside = figure.get_window_extent()
    shown = [text for text in figure.findobj(Text) if text.get_text().strip() and text.get_visible()]
    for text in (text for text in shown if not is_tick(text)):
        box = text.get_window_extent()
        assert box.x0 >= inside.x0 - 1.0 and box.x1 <= inside.x1 + 1.0, text.get_text()
    return [text.get_text().strip() for text in shown]


def test_every_road_is_a_mark_in_its_state() -> None:
    figure = draw_failure_map(POINTS, "title")
    shown = texts(figure)
    assert shown.count("1 requirement missed, 1 undrivable; 4 roads") == len(AXES)
    assert shown.count("2 stability lost, 1 undrivable; 4 roads") == len(AXES)
    for axes in figure.axes:
        marks = marks_of(axes)
        assert sorted(marks[:, 0]) == [5.0, 10.0, 20.0, 25.0]
        low, high = axes.get_ylim()
        assert all(low <= y <= high for y in marks[:, 1])
    assert min(marks_of(figure.axes[-1])[:, 1]) == LEAST_CURVATURE_1PM


def test_roads_that_all_pass_are_drawn_too() -> None:
    figure = draw_failure_map([RoadPoint(10.0, 0.0, 0.0, 0.0, {"tuned": PASSED})], "title")
    assert texts(figure).count("none failed; 1 roads") == len(AXES)


def test_shares_are_drawn_with_their_intervals() -> None:
    tuned, manual = ShareBar(1, 50, 0.0005, 0.1), ShareBar(0, 50, 0.0, 0.06)
    families = {"hills": {"tuned": tuned, "manual (a)": manual}, "turn": {"tuned": manual, "manual (a)": manual}}
    figure = draw_failure_shares(families, {"tuned": tuned, "manual (a)": manual, "other": tuned}, "title")
    assert {"hills (50)", "turn (50)", "1 of 50", "0 of 50", "other", "title"} <= set(texts(figure))
    by_family, by_set = figure.axes
    assert [np.asarray(line.get_xdata()).tolist() for line in by_family.get_lines()] == [[2.0, 0.0], [0.0, 0.0]]
    assert [np.asarray(line.get_xdata()).tolist() for line in by_set.get_lines()] == [[2.0], [0.0], [2.0]]
    assert by_set.get_xlim()[0] < 0.0 < 10.0 < by_set.get_xlim()[1]
