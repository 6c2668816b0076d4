"""Cells: every number is shown, nothing else is, and one colour means one thing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tools.measures.figures import cells
from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOWN, ACROSS = cells.CellAxis("dead time (s)", (0.05, 0.1)), cells.CellAxis("lag (s)", (0.077, 0.12, 0.25))
RATIOS = np.array([[0.5, 0.75, np.nan], [1.0, 1.25, 2.0]])


def words(figure: Figure) -> list[str]:
    from matplotlib.text import Text

    figure.canvas.draw()
    return [text.get_text() for text in figure.findobj(Text) if isinstance(text, Text) and text.get_visible()]


def test_cells_show_every_number_and_leave_out_what_was_not_measured() -> None:
    figure = cells.draw_cells({"tuned": RATIOS, "p = 0": RATIOS}, DOWN, ACROSS, "A title")
    shown = words(figure)
    for value in (0.5, 0.75, 1.0, 1.25, 2.0):
        assert shown.count(f"{value:.2f}") == 2
    assert "nan" not in " ".join(shown)
    assert {"A title", "tuned", "p = 0", "dead time (s)", "lag (s)", "0.077"} <= set(shown)


def test_equal_ratios_have_equal_colours_in_both_panels_and_no_change_is_the_middle() -> None:
    figure = cells.draw_cells({"a": RATIOS, "b": np.ones((2, 3))}, DOWN, ACROSS, "")
    first, second = (axes.images[0].get_array() for axes in figure.axes)
    assert first is not None and second is not None
    assert first[1, 0] == second[0, 0] == 0.5
    assert first[0, 0] == pytest.approx(0.0) and first[1, 2] == pytest.approx(1.0)


def test_they_are_written_as_a_picture(tmp_path: Path) -> None:
    path = style.save(cells.draw_cells({"tuned": RATIOS}, DOWN, ACROSS, "A title"), tmp_path / "cells.png")
    assert path.read_bytes()[:4] == b"\x89PNG"
