"""Errors over time with manual and with tuned parameters, one panel a manoeuvre and error (paper, Fig. 11)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Series = tuple[np.ndarray, np.ndarray]  # time and signal
COLUMNS = 2


class ErrorPanel(NamedTuple):
    """One panel: two drives of the same manoeuvre."""

    title: str
    name: str
    unit: str
    manual: Series
    tuned: Series

    @property
    def rms_manual(self) -> float:
        """Root mean square with the manual set."""
        return _rms(self.manual)

    @property
    def rms_tuned(self) -> float:
        """Root mean square with the tuned set."""
        return _rms(self.tuned)


def draw_errors(panels: Sequence[ErrorPanel]) -> Figure:
    """Draw the panels in rows of two, named (a), (b), ... as in the paper."""
    rows = -(-len(panels) // COLUMNS)
    figure = style.new_figure(14.0, 1.4 + 3.2 * rows)
    grid = figure.subplots(rows, COLUMNS, squeeze=False)
    for k, panel in enumerate(panels):
        axes = grid[k // COLUMNS, k % COLUMNS]
        axes.axhline(0.0, color=style.FAINT, linewidth=1.0)
        style.line(axes, *panel.manual, style.MANUAL._replace(width=1.4, dash="-"), "manual")
        style.line(axes, *panel.tuned, style.TUNED._replace(width=1.4), "auto-tuned")
        change = f"RMS {style.number(panel.rms_manual)} to {style.number(panel.rms_tuned)} {panel.unit}"
        title = f"({'abcdefghij'[k]}) {panel.title}, {panel.name}: {change}"
        is_last = k // COLUMNS == rows - 1
        style.dress(axes, "time (s)" if is_last else "", style.with_unit(panel.name, panel.unit), title)
    style.legend_below(figure, grid[0, 0], 2)
    lower = sum(panel.rms_tuned < panel.rms_manual for panel in panels)
    style.headline(figure, f"Auto-tuned (11 parameters) against manual: smaller RMS error in {lower} of {len(panels)}")
    return figure


def _rms(series: Series) -> float:
    values = series[1][np.isfinite(series[1])]
    return float(np.sqrt(np.mean(values * values)))
