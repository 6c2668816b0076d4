"""The course of a study: every score, the best so far, and the baselines (paper, III-B)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_history(scores: Sequence[float], lines: Mapping[str, float]) -> Figure:
    """Draw scores by slot on a log scale; lower is better.

    Args:
        scores: Scores in slot order.
        lines: Scores of the baselines by name, "manual" first.
    """
    figure = style.new_figure(11.0, 6.5)
    axes = figure.add_subplot()
    _draw_scores(axes, scores)
    _draw_lines(axes, lines)
    _log_score(axes, [*scores, *lines.values()])
    style.dress(axes, "trial", "score (lower is better)")
    axes.set_xlim(0.0, len(scores) + 1.0)
    style.legend_below(figure, axes, 3)
    style.headline(figure, _sentence(scores, lines))
    return figure


def _draw_scores(axes: Axes, scores: Sequence[float]) -> None:
    """The trials, the best so far, and the best trial."""
    trials = np.arange(1, len(scores) + 1)
    dots: dict[str, Any] = {"linestyle": "", "markeredgecolor": "white"}
    axes.plot(trials, scores, marker="o", markersize=6.0, color="#86b6d9", label="trial", **dots)
    so_far = np.minimum.accumulate(np.asarray(scores, dtype=np.float64))
    axes.step(trials, so_far, where="post", color=style.TUNED.colour, linewidth=2.8, label="best so far")
    best = int(np.argmin(scores))
    label = f"best: {style.number(scores[best])} in trial {best + 1}"
    star: dict[str, Any] = {"marker": "*", "markersize": 20, "color": style.TUNED.colour, "zorder": 6}
    axes.plot(trials[best], scores[best], label=label, **star, **dots)


def _sentence(scores: Sequence[float], lines: Mapping[str, float]) -> str:
    best, trials = min(scores), len(scores)
    if not lines:
        return f"Best score {style.number(best)} in {trials} trials"
    name = min(lines, key=lambda baseline: lines[baseline])
    change = 100.0 * (1.0 - best / lines[name])
    comparison = f"{abs(change):.0f} % {'below' if change > 0.0 else 'above'} the best baseline ({name})"
    return f"Best of {trials} trials: {style.number(best)}, {comparison}"


def _draw_lines(axes: Axes, lines: Mapping[str, float]) -> None:
    for name, look in style.looks(list(lines)).items():
        label = f"{name}: {style.number(lines[name])}"
        axes.axhline(lines[name], color=look.colour, linestyle=look.dash, linewidth=look.width, label=label)


def _log_score(axes: Axes, values: Sequence[float]) -> None:
    """A log scale, or a linear one where a score is 0."""
    if min(values) > 0.0:
        axes.set_yscale("log")
        style.plain_numbers(axes.yaxis, narrow=max(values) < 5.0 * min(values))
