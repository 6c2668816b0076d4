"""Figure of the coverage of a collection: seconds by steering and pedal, a panel for each speed band."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = "cividis"  # dark is empty, bright is full; colour-blind people see the same order
BLANK = "#e8e8e8"  # not requested
BRIGHT = 0.55  # share of the scale above which text is dark


class CoveragePanel(NamedTuple):
    """One speed band: seconds driven and requested, shape (n_pedal, n_steering); 0 requested: not part of the plan."""

    title: str
    have_s: NDArray[np.float64]
    need_s: NDArray[np.float64]
    rows: Sequence[str]
    columns: Sequence[str]


def draw_coverage(panels: Sequence[CoveragePanel], quota_s: float, title: str) -> Figure:
    """Draw every cell with its seconds, coloured by the share of the quota; cells that are not requested are grey."""
    figure = style.new_figure(2.6 + 4.6 * len(panels), 5.2)
    for i, panel in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), i + 1)
        _draw_panel(axes, panel)
        style.dress(axes, "", "", panel.title)
        axes.grid(False)
        axes.tick_params(length=0)
        axes.set_xticks(range(len(panel.columns)), panel.columns, rotation=45, ha="right", rotation_mode="anchor")
        axes.set_yticks(range(len(panel.rows)), panel.rows if i == 0 else [""] * len(panel.rows))
    style.headline(figure, f"{title}\nseconds by cell, {quota_s:g} requested; grey: not requested")
    return figure


def _draw_panel(axes: Axes, panel: CoveragePanel) -> None:
    wanted = panel.need_s > 0.0
    share = np.where(wanted, np.minimum(panel.have_s / np.where(wanted, panel.need_s, 1.0), 1.0), np.nan)
    axes.set_facecolor(BLANK)
    axes.imshow(np.ma.masked_invalid(share), cmap=COLOURS, vmin=0.0, vmax=1.0, aspect="auto")
    for (row, column), have_s in np.ndenumerate(panel.have_s):
        if wanted[row, column] or have_s > 0.0:
            dark = not wanted[row, column] or share[row, column] > BRIGHT
            text = f"{have_s:.1f}" if 0.0 < have_s < 9.95 else f"{have_s:.0f}"
            ink = style.INK if dark else "white"
            axes.text(column, row, text, ha="center", va="center", fontsize=style.FONT_PT - 1, color=ink)
