"""What adaptation adds to a tuned reference model: a ratio for each steering actuator, one row a law and a drift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPREAD = 0.28  # height over which the dots of a row are spread
NARROW = 4.0  # up to this ratio of the largest to the smallest, every digit has a tick


def draw_adaptation(rows: Mapping[str, Sequence[float]]) -> Figure:
    """Draw a dot for each actuator and a bar at the median, on a log axis with a line at 1.

    Args:
        rows: Lateral peak with p tuned over that with p = 0 and a T_ref of its own, by label; those of the robust law
            begin with 'robust'.
    """
    figure = style.new_figure(10.0, 1.8 + 0.5 * len(rows))
    axes = figure.add_subplot()
    for row, (label, ratios) in enumerate(rows.items()):
        look = style.TUNED if label.startswith("robust") else style.MANUAL
        heights = row + (np.linspace(-SPREAD, SPREAD, len(ratios)) if len(ratios) > 1 else np.zeros(1))
        axes.plot(
            ratios, heights, linestyle="", marker=look.marker, markersize=7.0, color=look.colour,
            markeredgecolor="white", zorder=3,
        )  # fmt: skip
        axes.plot([float(np.median(ratios))] * 2, [row - 0.4, row + 0.4], color=look.colour, linewidth=2.6, zorder=4)
    axes.axvline(1.0, color=style.INK, linestyle=":", linewidth=1.8)
    style.dress(axes, "lateral peak, p tuned / p = 0 with its own T_ref (below 1: adaptation helps)", "")
    axes.set_xscale("log")
    shown = [ratio for ratios in rows.values() for ratio in ratios]
    style.plain_numbers(axes.xaxis, narrow=max(shown) < NARROW * min(shown))
    style.name_bars(axes, list(rows), 0.4)
    style.headline(figure, _sentence(rows))
    return figure


def _sentence(rows: Mapping[str, Sequence[float]]) -> str:
    """Medians of the two laws over everything that they were driven with."""
    said = []
    for law in ("plain", "robust"):
        ratios = [ratio for label, row in rows.items() if label.startswith(law) for ratio in row]
        if ratios:
            said.append(f"{law} {float(np.median(ratios)):.2f}")
    return f"Lateral peak with adaptation over that without, median: {', '.join(said)}"
