"""The course of a study: every score, the best so far, and what it has to beat (paper, III-B)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def write_history(path: Path, scores: Sequence[float], lines: Mapping[str, float], **more: Sequence[float]) -> Path:
    """Write the figure of `draw_history` to `path` as PNG."""
    return style.save(draw_history(scores, lines, **more), path)


def draw_history(scores: Sequence[float], lines: Mapping[str, float], random: Sequence[float] = ()) -> Figure:
    """Scores by slot, lower is better, on a log scale.

    lines: baselines by name, "manual" first; `random`: scores of a random search at the same budget, drawn as its best
    so far.
    """
    figure = style.new_figure(11.0, 6.5)
    axes = figure.add_subplot()
    trials = np.arange(1, len(scores) + 1)
    best = np.minimum.accumulate(np.asarray(scores, dtype=np.float64))
    axes.plot(
        trials,
        scores,
        linestyle="",
        marker="o",
        markersize=6.0,
        color="#86b6d9",
        markeredgecolor="white",
        label="trial",
    )
    if random:
        chance = np.minimum.accumulate(np.asarray(random, dtype=np.float64))
        axes.step(
            np.arange(1, len(chance) + 1),
            chance,
            where="post",
            color=style.INK,
            linestyle=":",
            linewidth=2.2,
            label="random search, best so far",
        )
    axes.step(trials, best, where="post", color=style.TUNED.colour, linewidth=2.8, label="best so far")
    place = int(np.argmin(scores))
    axes.plot(
        trials[place],
        scores[place],
        marker="*",
        markersize=20,
        color=style.TUNED.colour,
        markeredgecolor="white",
        linestyle="",
        zorder=6,
        label=f"best: {style.number(scores[place])} in trial {place + 1}",
    )
    _draw_lines(axes, lines)
    _log_score(axes, [*scores, *lines.values()])
    style.dress(axes, "trial", "score (lower is better)")
    axes.set_xlim(0.0, len(scores) + 1.0)
    style.legend_below(figure, axes, 3)
    style.headline(figure, _sentence(scores, lines))
    return figure


def _sentence(scores: Sequence[float], lines: Mapping[str, float]) -> str:
    best, trials = min(scores), len(scores)
    if not lines:
        return f"Best score {style.number(best)} in {trials} trials"
    name = min(lines, key=lambda one: lines[one])
    change = 100.0 * (1.0 - best / lines[name])
    found = f"{abs(change):.0f} % {'below' if change > 0.0 else 'above'} the best baseline ({name})"
    return f"Best of {trials} trials: {style.number(best)}, {found}"


def _draw_lines(axes: Axes, lines: Mapping[str, float]) -> None:
    for name, look in style.looks(list(lines)).items():
        axes.axhline(
            lines[name],
            color=look.colour,
            linestyle=look.dash,
            linewidth=look.width,
            label=f"{name}: {style.number(lines[name])}",
        )


def _log_score(axes: Axes, values: Sequence[float]) -> None:
    """A log scale, or a linear one when a score is 0."""
    if min(values) > 0.0:
        axes.set_yscale("log")
        style.plain_numbers(axes.yaxis, narrow=max(values) < 5.0 * min(values))
