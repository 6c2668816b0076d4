"""Importance of the parameters: shares by PED-ANOVA, and the rank correlation with its sign."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from tunefree_hil.figures import style
from tunefree_hil.tune.insight import Importance

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_importance(importances: Mapping[str, Importance], objective: str = "score") -> Figure:
    """Draw bars, the most important on top: shares, or absolute rank correlations where there are no shares.

    objective: What the importance is for.
    """
    names = list(importances)
    n = importances[names[0]].n
    by_share = all(importance.share is not None for importance in importances.values())
    figure = style.new_figure(10.0, 2.0 + 0.48 * len(names))
    axes = figure.add_subplot()
    for row, name in enumerate(names):
        importance = importances[name]
        length = (importance.share or 0.0) if by_share else abs(importance.rank)
        axes.barh(row, length, 0.7, color=style.TUNED.colour)
        trend = "larger is worse" if importance.rank > 0.0 else "larger is better"
        sign = "no trend" if abs(importance.rank) < 0.1 else trend
        bar_text = f" {style.number(length)}  (rank correlation {importance.rank:+.2f}: {sign})"
        axes.text(length, row, bar_text, va="center", fontsize=style.FONT_PT - 2.0, color=style.INK)
    longest = max((entry.share or 0.0) if by_share else abs(entry.rank) for entry in importances.values())
    axes.set_xlim(0.0, 1.9 * (longest or 1.0))
    label = "share of importance (PED-ANOVA)" if by_share else "|rank correlation| (no shares from these trials)"
    style.dress(axes, label, "")
    style.name_bars(axes, names)
    axes.tick_params(axis="y", labelsize=style.FONT_PT)
    purpose = "" if objective == "score" else f" for {objective}"
    style.headline(figure, f"Importance of the parameters{purpose}, from {n} trials")
    return figure
