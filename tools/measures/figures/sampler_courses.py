"""Best score so far over the trials, by method: samplers of the product above, optimisers of other projects below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito, the dark ones; a dash for each too, as two methods may have the same colour in the two rows
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#222222", "#7f7f7f", "#8c6d31")
DASHES = ("-", "--", "-.", ":")
FIRST_SHOWN = 8  # trials: before, every method is at the first trial
BAND_ALPHA = 0.08
ROOM = 0.03  # above and below, in parts of the range


class SamplerPanel(NamedTuple):
    """The searches with so many trials in flight.

    courses: Best so far by method and seed, after each trial.
    autos: The same of `auto` by number of trials and seed.
    """

    in_flight: int
    courses: Mapping[str, Sequence[Sequence[float]]]
    autos: Mapping[int, Sequence[float]]


def draw_courses(panels: Sequence[SamplerPanel], peers: Sequence[str], sentence: str) -> Figure:
    """Draw medians of seeds with bands from the best to the worst one, and `auto` as dots in all panels.

    peers: the methods of other projects, for the lower row.
    """
    figure = style.new_figure(7.4 * len(panels) + 0.6, 11.0)
    rows = [("samplers of the product", False), ("other optimisers", True)]
    for place, panel in enumerate(panels):
        for row, (what, is_peer) in enumerate(rows):
            axes = figure.add_subplot(len(rows), len(panels), 1 + row * len(panels) + place)
            methods = [name for name in panel.courses if (name in peers) == is_peer]
            for k, name in enumerate(methods):
                _draw_course(axes, panel.courses[name], name, k)
            _draw_auto(axes, panel.autos)
            title = f"{what}, {panel.in_flight} in flight" if panel.in_flight > 1 else f"{what}, one after the other"
            _dress(axes, panel, title)
    style.headline(figure, sentence)
    return figure


def _draw_course(axes: Axes, courses: Sequence[Sequence[float]], name: str, k: int) -> None:
    scores = np.array(courses)
    trials = np.arange(1, scores.shape[1] + 1)
    look = style.Look(COLOURS[k % len(COLOURS)], DASHES[k % len(DASHES)], "", 2.0)
    axes.fill_between(trials, scores.min(axis=0), scores.max(axis=0), color=look.colour, alpha=BAND_ALPHA, linewidth=0)
    style.line(axes, trials, np.median(scores, axis=0), look, name)


def _draw_auto(axes: Axes, autos: Mapping[int, Sequence[float]]) -> None:
    trials, middles = list(autos), np.array([np.median(scores) for scores in autos.values()])
    reach = np.array([[min(scores), max(scores)] for scores in autos.values()]).T
    axes.errorbar(
        trials, middles, yerr=np.abs(reach - middles), linestyle="", marker="o", markersize=9.0, capsize=5.0,
        color=style.INK, markeredgecolor="white", zorder=5, label="auto",
    )  # fmt: skip


def _dress(axes: Axes, panel: SamplerPanel, title: str) -> None:
    last = max(panel.autos)
    first = min(FIRST_SHOWN, last - 1)
    shown = [score for courses in panel.courses.values() for course in courses for score in course[first - 1 :]]
    low, high = min(shown), max(shown)
    axes.set_xscale("log")
    axes.set_xlim(first, 1.06 * last)
    axes.set_ylim(low - ROOM * (high - low), high + ROOM * (high - low))
    style.dress(axes, "trials", "best score so far", title)
    style.plain_numbers(axes.xaxis)
    axes.legend(fontsize=style.FONT_PT - 2, framealpha=0.85, edgecolor="none", ncols=2, loc="upper right")
