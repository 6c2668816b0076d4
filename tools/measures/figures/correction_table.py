"""Errors with corrections over those without, as numbers in coloured cells, one panel for each vehicle and gain set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tools.measures.figures.cells import COLOURS, DARK
from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = ("lateral", "station", "speed")
PANELS_ACROSS = 4
LEAST_SCALE = 0.05  # of the colours, in the logarithm


class CorrectionCells(NamedTuple):
    """By correction: three ratios (COLUMNS), and the number of oscillating drives, not written where it is 0."""

    ratios: list[Sequence[float]]
    oscillating: list[int]


def draw_corrections(panels: Mapping[str, CorrectionCells], names: Sequence[str]) -> Figure:
    """Draw a table for each panel; all share one colour scale, symmetrical about 1 in the logarithm.

    Args:
        panels: Cells by title; a row for each of `names`.
        names: The corrections.
    """
    across = min(PANELS_ACROSS, len(panels))
    down = -(-len(panels) // across)
    figure = style.new_figure(3.6 + 3.3 * across, 1.2 + (0.9 + 0.45 * len(names)) * down)
    known = np.abs(np.log([ratio for cells in panels.values() for row in cells.ratios for ratio in row]))
    scale = max(float(np.max(known[np.isfinite(known)], initial=0.0)), LEAST_SCALE)
    for place, (title, cells) in enumerate(panels.items()):
        axes = figure.add_subplot(down, across, place + 1)
        _draw_panel(axes, cells, scale)
        style.dress(axes, "", "", title)
        axes.grid(False)
        axes.set_xticks(range(len(COLUMNS) + 1), [*COLUMNS, "swings"])
        axes.set_yticks(range(len(names)), list(names) if place % across == 0 else [""] * len(names))
    style.headline(figure, "Errors on the vehicle over those of the plain controller with the same gains")
    return figure


def _draw_panel(axes: Axes, cells: CorrectionCells, scale: float) -> None:
    ratios = np.array(cells.ratios, dtype=np.float64)
    place = 0.5 + 0.5 * np.log(ratios) / scale
    shown = np.column_stack([place, np.full(len(place), np.nan)])
    axes.imshow(shown, cmap=COLOURS, vmin=0.0, vmax=1.0, aspect="auto")
    for (row, column), ratio in np.ndenumerate(ratios):
        if np.isfinite(ratio):
            ink = "white" if abs(place[row, column] - 0.5) > DARK else style.INK
            axes.text(column, row, f"{ratio:.2f}", ha="center", va="center", fontsize=style.FONT_PT - 1, color=ink)
    for row, count in enumerate(cells.oscillating):
        if count:
            axes.text(len(COLUMNS), row, str(count), ha="center", va="center", fontsize=style.FONT_PT - 1)
