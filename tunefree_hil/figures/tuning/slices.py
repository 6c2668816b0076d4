"""One-dimensional slices through the winner: how the score changes when one parameter leaves its place."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 3
DECADES_FROM = 60.0  # widest box, as a ratio, with numbers between its powers of ten
HIGHEST = 3.0  # of the winner's score, or of the manual one if that is more: what is above is cut and marked


class Slice(NamedTuple):
    """One parameter across its box; score None where the bench failed. `flag`: what is said of the winner's place."""

    values: Sequence[float]
    scores: Sequence[float | None]
    winner: float
    log: bool
    unit: str = ""
    flag: str = ""


def write_slices(path: Path, slices: Mapping[str, Slice], best: float, manual: float, title: str) -> Path:
    """Write the figure of `draw_slices` to `path` as PNG."""
    return style.save(draw_slices(slices, best, manual, title), path)


def draw_slices(slices: Mapping[str, Slice], best: float, manual: float, title: str) -> Figure:
    """A panel a parameter, each with a scale of its own; best, manual: the winner's and the best manual score."""
    columns = min(COLUMNS, len(slices))
    rows = math.ceil(len(slices) / columns)
    figure = style.new_figure(max(7.0, 4.2 * columns), 1.6 + 3.3 * rows)
    top = HIGHEST * max(best, manual)
    for i, (name, one) in enumerate(slices.items()):
        axes = figure.add_subplot(rows, columns, i + 1)
        _draw_slice(axes, one, best, manual, top)
        unit = f" ({one.unit})" if one.unit and one.unit != "1" else ""
        style.dress(axes, f"{name}{unit}", "score" if i % columns == 0 else "", one.flag)
        if i == 0:
            style.legend_below(figure, axes, 2 if columns < COLUMNS else 4)
    style.headline(figure, title)
    return figure


def _decades(axes: Axes) -> None:
    """Numbers at 1, 10, 100 only, where more would run into each other."""
    from matplotlib.ticker import LogLocator

    axes.xaxis.set_major_locator(LogLocator(subs=(1.0,)))


def _draw_slice(axes: Axes, one: Slice, best: float, manual: float, top: float) -> None:
    """The line through the points, the winner, the manual score; points above the top sit on it as triangles."""
    known = sorted((value, score) for value, score in zip(one.values, one.scores, strict=True) if score is not None)
    line = sorted([*known, (one.winner, best)])
    if one.log:
        axes.set_xscale("log")
    look = style.OTHERS[0]
    axes.plot([v for v, _ in line], [min(s, top) for _, s in line], color=look.colour, linewidth=2.0, zorder=2)
    inside = [(v, s) for v, s in known if s <= top]
    axes.plot([v for v, _ in inside], [s for _, s in inside], "s", color=look.colour, label="winner, one value changed")
    above = [v for v, s in known if s > top]
    axes.plot(above, [top] * len(above), "^", color=style.MANUAL.colour, markersize=9, label="above the picture")
    axes.axhline(manual, color=style.MANUAL.colour, linestyle="--", linewidth=1.6, label="best manual")
    axes.plot([one.winner], [best], "*", color=style.TUNED.colour, markersize=17, zorder=4, label="winner")
    lowest = min([s for _, s in inside] + [best, manual])
    axes.set_ylim(max(0.0, 0.85 * lowest), min(top, max([s for _, s in inside] + [best, manual]) * 1.08) * 1.02)
    if above:
        axes.set_ylim(top=1.05 * top)
    if one.log:
        style.plain_numbers(axes.xaxis, narrow=max(one.values) < 10.0 * min(one.values))
        if max(one.values) > DECADES_FROM * min(one.values):
            _decades(axes)
