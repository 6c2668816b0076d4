"""The coverage picture: every asked cell with its seconds, nothing in those that are not asked for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tunefree_hil.figures.learning.coverage import CoveragePanel, draw_coverage
from tunefree_hil.figures.style import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HAVE = np.array([[0.0, 4.26, 12.0], [0.0, 0.0, 0.0]])
NEED = np.array([[10.0, 10.0, 10.0], [0.0, 10.0, 0.0]])
PANEL = CoveragePanel("0.2-10 m/s", HAVE, NEED, ["brake high", "throttle high"], ["left", "straight", "right"])


def words(figure: Figure) -> list[str]:
    from matplotlib.text import Text

    figure.canvas.draw()
    return [text.get_text() for text in figure.findobj(Text) if isinstance(text, Text) and text.get_visible()]


def test_every_asked_cell_is_shown_with_its_seconds_and_no_other() -> None:
    shown = words(draw_coverage([PANEL, PANEL], 10.0, "A title"))
    assert shown.count("4.3") == 2 and shown.count("12") == 2
    assert shown.count("0") == 4  # two asked cells a panel are empty; the two that are not asked for say nothing
    assert {"0.2-10 m/s", "brake high", "straight"} <= set(shown)
    assert any("A title" in text and "10 requested" in text for text in shown)


def test_a_full_cell_is_as_bright_as_one_that_is_more_than_full() -> None:
    figure = draw_coverage([PANEL._replace(have_s=np.array([[10.0, 40.0, 0.0], [0.0, 0.0, 0.0]]))], 10.0, "")
    image = figure.axes[0].images[0].get_array()
    assert image is not None and image[0, 0] == image[0, 1] == 1.0 and image[0, 2] == 0.0
    assert np.ma.getmaskarray(image).tolist() == [[False, False, False], [True, False, True]]


def test_it_is_written_as_a_picture(tmp_path: Path) -> None:
    path = save(draw_coverage([PANEL], 10.0, "A title"), tmp_path / "coverage.png")
    assert path.read_bytes()[:4] == b"\x89PNG"
