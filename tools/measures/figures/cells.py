"""Figure of a ratio over two properties of the vehicle, as numbers in coloured cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = "RdYlBu_r"  # blue is better; colour-blind people can tell its ends apart
DARK = 0.32  # distance of a colour from the middle of its map beyond which text on it is white


class CellAxis(NamedTuple):
    """One property: its label with unit, and its values."""

    label: str
    values: Sequence[float]


def draw_cells(panels: Mapping[str, NDArray[np.float64]], down: CellAxis, across: CellAxis, title: str) -> Figure:
    """Draw a table for each panel; all share one colour scale, symmetrical about 1 in the logarithm.

    Args:
        panels: Ratios by title, 1 = no change, below 1 better, shape (n_down, n_across); NaN is an empty cell.
        down: Property of the rows.
        across: Property of the columns.
        title: Title of the figure.
    """
    figure = style.new_figure(1.5 + (1.2 * len(across.values) + 0.9) * len(panels), 2.6 + 0.8 * len(down.values))
    ratios = np.concatenate([np.asarray(values, dtype=np.float64).ravel() for values in panels.values()])
    scale = max(float(np.nanmax(np.abs(np.log(ratios)))), 0.05)
    for i, (name, values) in enumerate(panels.items()):
        axes = figure.add_subplot(1, len(panels), i + 1)
        _draw_panel(axes, np.asarray(values, dtype=np.float64), scale)
        style.dress(axes, across.label, down.label if i == 0 else "", name)
        axes.grid(False)
        axes.set_xticks(range(len(across.values)), [style.number(value) for value in across.values])
        axes.set_yticks(range(len(down.values)), [style.number(value) for value in down.values])
    style.headline(figure, title)
    return figure


def _draw_panel(axes: Axes, values: NDArray[np.float64], scale: float) -> None:
    place = 0.5 + 0.5 * np.log(values) / scale
    axes.imshow(place, cmap=COLOURS, vmin=0.0, vmax=1.0, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            ink = "white" if abs(place[row, column] - 0.5) > DARK else style.INK
            axes.text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=style.FONT_PT, color=ink)
