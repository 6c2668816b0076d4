"""All metrics of one run or of several side by side, by aspect, and the highlighted ones alone (paper, Fig. 11)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tunefree_hil.figures import style
from tunefree_hil.grade.table import (
    COMFORT,
    DEAD_BAND,
    EFFORT,
    HIGHLIGHTED,
    LATENCY,
    LOCALISATION,
    PERFORMANCE,
    SAFETY,
    names_by_aspect,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Values = Mapping[str, Mapping[str, float | None]]  # label -> metric -> value
SIDES = ((PERFORMANCE, LOCALISATION, DEAD_BAND), (SAFETY, COMFORT, EFFORT, LATENCY))
BAR_IN = 0.19
GAP_IN = 0.2
HATCHES = ("", "//", "..", "xx", "\\\\", "++")  # labels can be distinguished without colour


def draw_profile(values: Values, title: str) -> Figure:
    """Bars of all metrics, a panel an aspect; missing values are labelled."""
    groups = names_by_aspect()
    row_in = BAR_IN * len(values) + GAP_IN
    height = 1.6 + max(sum(0.75 + row_in * len(groups[aspect]) for aspect in side) for side in SIDES)
    figure = style.new_figure(14.0, height)
    halves: Any = figure.subfigures(1, 2)
    for side, half in zip(SIDES, halves, strict=True):
        grid = half.add_gridspec(len(side), 1, height_ratios=[0.5 / row_in + len(groups[aspect]) for aspect in side])
        for i, aspect in enumerate(side):
            _draw_panel(half.add_subplot(grid[i]), values, groups[aspect], aspect)
    _finish(figure, values, title)
    return figure


def draw_highlights(values: Values, title: str) -> Figure:
    """Bars of the paper's nine highlighted metrics: four RMS, four peaks, compute time."""
    figure = style.new_figure(11.0, 1.9 + (BAR_IN * 1.3 * len(values) + GAP_IN) * len(HIGHLIGHTED))
    panel_title = "dimensionless, lower is better; a peak of 1 is its published threshold"
    _draw_panel(figure.add_subplot(), values, HIGHLIGHTED, panel_title)
    _finish(figure, values, title)
    return figure


def _finish(figure: Figure, values: Values, title: str) -> None:
    from matplotlib.patches import Patch

    if len(values) > 1:
        handles = [
            Patch(facecolor=look.colour, hatch=hatch, edgecolor="white", label=label)
            for label, (look, hatch) in _looks(values).items()
        ]
        columns = min(3, len(values))
        place = "outside lower center"
        figure.legend(handles=handles, loc=place, ncols=columns, fontsize=style.FONT_PT, frameon=False)
    style.headline(figure, title)


def _looks(values: Values) -> dict[str, tuple[style.Look, str]]:
    looks = style.looks(list(values))
    return {label: (looks[label], HATCHES[i % len(HATCHES)]) for i, label in enumerate(values)}


def _draw_panel(axes: Axes, values: Values, names: Sequence[str], title: str) -> None:
    """Groups of bars, the first metric on top; the axis reaches to the longest of them."""
    width = 0.84 / len(values)
    largest = max((_known(values[label].get(name)) for label in values for name in names), default=0.0)
    end = largest if largest > 0.0 else 1.0
    for place, (label, (look, hatch)) in enumerate(_looks(values).items()):
        for row, name in enumerate(names):
            value = values[label].get(name)
            position = row + (place - 0.5 * (len(values) - 1)) * width
            axes.barh(position, _known(value), 0.9 * width, color=look.colour, hatch=hatch, edgecolor="white")
            text = " not available" if value is None else f" {style.number(value)}"
            colour = style.FAINT if value is None else style.INK
            axes.text(_known(value), position, text, va="center", fontsize=style.FONT_PT - 2.5, color=colour)
    axes.set_xlim(0.0, 1.18 * end)
    style.dress(axes, "", "", title)
    style.name_bars(axes, names)
    axes.tick_params(axis="y", labelsize=style.FONT_PT - 2.0)


def _known(value: float | None) -> float:
    return value if value is not None and math.isfinite(value) else 0.0
