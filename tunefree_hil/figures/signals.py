"""Signals of a log over time: a panel a unit, a line a signal, interrupted where nothing was received."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANEL_IN, MOST_IN = 2.4, 24.0  # height of a panel, of all


class Series(NamedTuple):
    """One signal: its name, its unit ('' = none), stamps and values, and the gap from which a line is interrupted."""

    name: str
    unit: str
    time_s: NDArray[np.float64]
    values: NDArray[np.float64]
    gap_s: float


def draw_signals(title: str, series: Sequence[Series]) -> Figure:
    """Signals of one unit share a panel; time counts from the first stamp of all. Gaps are shaded."""
    units = list(dict.fromkeys(one.unit for one in series))
    figure = style.new_figure(13.0, min(MOST_IN, 1.2 + PANEL_IN * len(units)))
    received = [one for one in series if one.time_s.size]
    zero_s = min((float(one.time_s[0]) for one in received), default=0.0)
    first: Axes | None = None
    for row, unit in enumerate(units):
        axes = figure.add_subplot(len(units), 1, row + 1, sharex=first)
        first = first or axes
        _panel(axes, [one for one in series if one.unit == unit], zero_s)
        last = row == len(units) - 1
        style.dress(axes, f"time (s) from {zero_s:.3f} s on" if last else "", unit or "(no unit)")
        axes.tick_params(labelbottom=last)
    style.headline(figure, title)
    return figure


def broken_at_gaps(series: Series) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(stamps, values) with a NaN in the middle of each gap, so that no line is drawn across it."""
    gaps = gaps_of(series)
    middles = 0.5 * (series.time_s[gaps] + series.time_s[gaps + 1])
    return np.insert(series.time_s, gaps + 1, middles), np.insert(series.values, gaps + 1, np.nan)


def gaps_of(series: Series) -> NDArray[np.int64]:
    """Indices of the last values before a gap longer than gap_s."""
    return np.flatnonzero(np.diff(series.time_s) > series.gap_s)


def _panel(axes: Axes, series: Sequence[Series], zero_s: float) -> None:
    for line, look in zip(series, _looks(len(series)), strict=True):
        if not line.time_s.size:
            style.line(axes, [], [], look, f"{line.name} (never received)")
            continue
        times, values = broken_at_gaps(line)
        single = line.values.size == 1
        style.line(axes, times - zero_s, values, look._replace(marker=""), line.name)
        if single:
            axes.plot(times - zero_s, values, marker="o", color=look.colour)
        for i in gaps_of(line):
            axes.axvspan(
                float(line.time_s[i]) - zero_s, float(line.time_s[i + 1]) - zero_s, color=look.colour, alpha=0.12, lw=0
            )
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=style.FONT_PT - 1.5, frameon=False)


def _looks(count: int) -> list[style.Look]:
    """A look for each line of a panel."""
    known = (style.TUNED, style.MANUAL, *style.OTHERS)
    return [known[i % len(known)]._replace(width=1.6) for i in range(count)]
