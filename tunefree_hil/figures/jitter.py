"""Lateness of each tick of a real-time run, by node (docs/reference/bench_channel.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MS_PER_S = 1000.0
BINS = 60


def draw_jitter(late_s: Mapping[str, Sequence[float]], limit_s: float) -> Figure:
    """Histogram of lateness in ms, counts on a log scale so that a single late tick is visible.

    late_s: by node, one value a tick, done minus deadline, seconds, negative is early. limit_s: what still counts as
    real time.
    """
    figure = style.new_figure(10.0, 6.0)
    axes = figure.add_subplot()
    late_ms = {name: np.asarray(values, dtype=np.float64) * MS_PER_S for name, values in late_s.items() if len(values)}
    everything = np.concatenate([*late_ms.values(), [0.0, limit_s * MS_PER_S]])
    bins = np.linspace(everything.min(), everything.max() * 1.02, BINS + 1)
    for (name, values), look in zip(late_ms.items(), (style.TUNED, style.MANUAL, *style.OTHERS), strict=False):
        median, high = np.quantile(values, [0.5, 0.99])
        text = (
            f"{name}: median {style.number(median)}, 99 % {style.number(high)}, worst {style.number(values.max())} ms"
        )
        axes.hist(values, bins=bins.tolist(), histtype="stepfilled", color=look.colour, alpha=0.25)
        axes.hist(values, bins=bins.tolist(), histtype="step", color=look.colour, linewidth=look.width, label=text)
    axes.axvline(limit_s * MS_PER_S, color=style.INK, linestyle="--", linewidth=2.0, label="limit of real time")
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.7)
    style.plain_numbers(axes.yaxis)
    style.dress(axes, "done after the deadline (ms)", "ticks")
    style.legend_below(figure, axes, 1)
    style.headline(figure, _sentence(late_ms, limit_s * MS_PER_S))
    return figure


def _sentence(late_ms: Mapping[str, np.ndarray], limit_ms: float) -> str:
    ticks = sum(values.size for values in late_ms.values())
    late = sum(int(np.count_nonzero(values > limit_ms)) for values in late_ms.values())
    return f"{late} of {ticks} ticks later than {style.number(limit_ms)} ms" if ticks else "No tick was timed"
