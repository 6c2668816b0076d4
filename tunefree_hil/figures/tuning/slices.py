"""One-dimensional slices through the winner: the score as a function of one parameter."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 3
MAX_DENSE_RATIO = 60.0  # widest range, as a ratio, with tick labels between powers of ten
MAX_SCORE_RATIO = 3.0  # of the larger one of winner's and manual score: points above are marked at the top


class ParameterSlice(NamedTuple):
    """One parameter across its range; score None where the bench failed.

    flag: A remark about the winner's value.
    choices: The values have no order: they are drawn side by side, without a line.
    """

    values: Sequence[float]
    scores: Sequence[float | None]
    winner: float
    log: bool
    unit: str = ""
    flag: str = ""
    choices: bool = False

    def by_place(self) -> ParameterSlice:
        """The slice of choices with their places, 0, 1, ..., instead of their values."""
        values = sorted({*self.values, self.winner})
        places = [float(values.index(value)) for value in self.values]
        return self._replace(values=places, winner=float(values.index(self.winner)), log=False)


def draw_slices(
    slices: Mapping[str, ParameterSlice], best: float, manual: float, title: str, objective: str = "score"
) -> Figure:
    """Draw one panel a parameter, each with its own scale.

    Args:
        slices: By parameter.
        best: Score of the winner.
        manual: Best manual score.
        title: Headline of the figure.
        objective: What the scores are.
    """
    columns = min(COLUMNS, len(slices))
    rows = math.ceil(len(slices) / columns)
    figure = style.new_figure(max(7.0, 4.2 * columns), 1.6 + 3.3 * rows)
    top = MAX_SCORE_RATIO * max(best, manual)
    for i, (name, parameter_slice) in enumerate(slices.items()):
        axes = figure.add_subplot(rows, columns, i + 1)
        _draw_slice(axes, parameter_slice, best, manual, top)
        label = style.with_unit(name, parameter_slice.unit)
        style.dress(axes, label, objective if i % columns == 0 else "", parameter_slice.flag)
        if i == 0:
            style.legend_below(figure, axes, 2 if columns < COLUMNS else 4)
    style.headline(figure, title)
    return figure


def _draw_slice(axes: Axes, parameter_slice: ParameterSlice, best: float, manual: float, top: float) -> None:
    """Draw the slice, the winner and the manual score; points above the top are triangles at the top."""
    from matplotlib.ticker import LogLocator

    if parameter_slice.choices:
        labels = [style.number(value) for value in sorted({*parameter_slice.values, parameter_slice.winner})]
        axes.set_xticks(range(len(labels)), labels)
        axes.set_xlim(-0.5, len(labels) - 0.5)
        parameter_slice = parameter_slice.by_place()
    pairs = zip(parameter_slice.values, parameter_slice.scores, strict=True)
    known = sorted((value, score) for value, score in pairs if score is not None)
    line = sorted([*known, (parameter_slice.winner, best)])
    if parameter_slice.log:
        axes.set_xscale("log")
    look = style.OTHERS[0]
    if not parameter_slice.choices:
        axes.plot([v for v, _ in line], [min(s, top) for _, s in line], color=look.colour, linewidth=2.0, zorder=2)
    inside = [(v, s) for v, s in known if s <= top]
    axes.plot([v for v, _ in inside], [s for _, s in inside], "s", color=look.colour, label="winner, one value changed")
    above = [v for v, s in known if s > top]
    axes.plot(above, [top] * len(above), "^", color=style.MANUAL.colour, markersize=9, label="above the picture")
    axes.axhline(manual, color=style.MANUAL.colour, linestyle="--", linewidth=1.6, label="best manual")
    axes.plot([parameter_slice.winner], [best], "*", color=style.TUNED.colour, markersize=17, zorder=4, label="winner")
    lowest = min([s for _, s in inside] + [best, manual])
    axes.set_ylim(max(0.0, 0.85 * lowest), min(top, max([s for _, s in inside] + [best, manual]) * 1.08) * 1.02)
    if above:
        axes.set_ylim(top=1.05 * top)
    if parameter_slice.log:
        style.plain_numbers(axes.xaxis, narrow=max(parameter_slice.values) < 10.0 * min(parameter_slice.values))
        if max(parameter_slice.values) > MAX_DENSE_RATIO * min(parameter_slice.values):
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0,)))  # 1, 10, 100 only: more labels would overlap
