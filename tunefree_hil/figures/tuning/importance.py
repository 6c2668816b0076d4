"""How much each parameter matters: shares by PED-ANOVA, and the sign of the rank correlation beside them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from tunefree_hil.figures import style
from tunefree_hil.tune.insight import Importance

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_importance(path: Path, found: Mapping[str, Importance]) -> Path:
    """Write the figure of `draw_importance` to `path` as PNG."""
    return style.save(draw_importance(found), path)


def draw_importance(found: Mapping[str, Importance]) -> Figure:
    """Bars, the most important on top: shares where they could be had, else the size of the rank correlation."""
    names = list(found)
    n = found[names[0]].n
    by_share = all(one.share is not None for one in found.values())
    figure = style.new_figure(10.0, 2.0 + 0.48 * len(names))
    axes = figure.add_subplot()
    for row, name in enumerate(names):
        one = found[name]
        length = (one.share or 0.0) if by_share else abs(one.rank)
        axes.barh(row, length, 0.7, color=style.TUNED.colour)
        sign = "no trend" if abs(one.rank) < 0.1 else "larger is worse" if one.rank > 0.0 else "larger is better"
        said = f" {style.number(length)}  (rank correlation {one.rank:+.2f}: {sign})"
        axes.text(length, row, said, va="center", fontsize=style.FONT_PT - 2.0, color=style.INK)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.45, -0.55)
    longest = max((one.share or 0.0) if by_share else abs(one.rank) for one in found.values())
    axes.set_xlim(0.0, 1.9 * (longest or 1.0))
    what = "share of importance (PED-ANOVA)" if by_share else "|rank correlation| (too few trials for shares)"
    style.dress(axes, what, "")
    axes.tick_params(axis="y", labelsize=style.FONT_PT)
    axes.grid(False, axis="y")
    style.headline(figure, f"What matters, by {n} trials")
    return figure
