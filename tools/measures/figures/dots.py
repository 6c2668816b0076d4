"""Several rows of scores, one dot each: the tuned studies against baselines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SPREAD = 0.32  # height of a row over which its dots are spread, so that equal scores are visible
WIDE = 6.0  # from this ratio of the largest to the smallest score on the axis is logarithmic


def draw_dots(rows: Mapping[str, Sequence[float]], what: str, best: str = "") -> Figure:
    """rows: scores by label, lower is better, drawn from the top; one score for a baseline, one a seed for a search.

    A row of several has a bar at its median. `what`: the label of the axis. `best`: the row with the score to beat,
    drawn as a line through all rows.
    """
    figure = style.new_figure(11.0, 2.3 + 0.55 * len(rows))
    axes = figure.add_subplot()
    for row, (label, scores) in enumerate(rows.items()):
        look = style.TUNED if label.startswith("tuned") else style.MANUAL if label == best else style.OTHERS[0]
        _draw_row(axes, row, scores, look)
    if best:
        axes.axvline(rows[best][0], color=style.MANUAL.colour, linestyle="--", linewidth=1.8, zorder=2)
    style.dress(axes, what, "")
    _scale(axes, [score for scores in rows.values() for score in scores])
    style.name_bars(axes, list(rows), 0.4)
    axes.tick_params(axis="y", labelsize=style.FONT_PT)
    style.headline(figure, _sentence(rows, best))
    return figure


def _draw_row(axes: Axes, row: int, scores: Sequence[float], look: style.Look) -> None:
    """The dots, their median as a bar where there are several, and as a number."""
    heights = row + (np.linspace(-SPREAD, SPREAD, len(scores)) if len(scores) > 1 else np.zeros(1))
    axes.plot(
        scores, heights, linestyle="", marker=look.marker, markersize=10.0, color=look.colour, markeredgecolor="white",
        zorder=4,
    )  # fmt: skip
    middle = float(np.median(scores))
    if len(scores) > 1:
        axes.plot([middle] * 2, [row - 0.42, row + 0.42], color=look.colour, linewidth=2.6, zorder=3)
    axes.annotate(
        style.number(middle), (max(scores), row), xytext=(12, 0), textcoords="offset points", va="center", zorder=5,
        fontsize=style.FONT_PT - 1.5, color=style.INK, bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )  # fmt: skip


def _scale(axes: Axes, values: Sequence[float]) -> None:
    """Room for the numbers on the right; a log scale where the scores are far apart."""
    low, high = min(values), max(values)
    if low <= 0.0:
        return
    if high > WIDE * low:
        axes.set_xscale("log")
        style.plain_numbers(axes.xaxis)
        axes.set_xlim(low / 1.1, high * (high / low) ** 0.08)
    else:
        edge = max(high - low, 0.02 * high)
        axes.set_xlim(low - 0.06 * edge, high + 0.14 * edge)


def _sentence(rows: Mapping[str, Sequence[float]], best: str) -> str:
    """Comparison of the tuned row with the best single score."""
    tuned = next((scores for label, scores in rows.items() if label.startswith("tuned")), None)
    if tuned is None or not best:
        return "Scores"
    line = rows[best][0]
    wins = sum(score < line for score in tuned)
    change = 100.0 * (float(np.median(tuned)) / line - 1.0) if line > 0.0 else 0.0
    return f"Tuned beats {best}, the best baseline, in {wins} of {len(tuned)} studies (median {change:+.0f} %)"
