"""Winners of several searches in the plane of two parameters, beside the manual set (paper, Fig. 8a and 10)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.figures import style
from tunefree_hil.figures.tuning.scatter import ParameterBox

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999999", "#000000", "#f0e442")
MARKERS = {True: "s", False: "o"}  # of the first family of settings, and of the second


class WinnerPoint(NamedTuple):
    """One winner. is_first_family: of two families of settings, which have a marker each."""

    label: str
    x: float
    y: float
    score: float
    is_first_family: bool


Side = tuple[str, ParameterBox]  # name and range of an axis


def draw_winners(points: Sequence[WinnerPoint], manual: WinnerPoint, sides: tuple[Side, Side], title: str) -> Figure:
    """Draw the whole box at the left, the part with the points at the right; the legend has the scores."""
    figure = style.new_figure(14.0, 7.4)
    whole, near = figure.subplots(1, 2)
    for axes in (whole, near):
        _draw_points(axes, points, manual)
        for which, (_, box) in zip("xy", sides, strict=True):
            if box.log:
                getattr(axes, f"set_{which}scale")("log")
                style.plain_numbers(getattr(axes, f"{which}axis"))
        style.dress(axes, *(style.with_unit(name, box.unit) for name, box in sides))
    for which, (_, box) in zip("xy", sides, strict=True):
        getattr(whole, f"set_{which}lim")(*_wider(box.low, box.high, box.log, 0.04))
    _zoom(near, [*points, manual], sides)
    whole.set_title("the whole box", fontsize=style.FONT_PT, loc="left")
    near.set_title("the part with the winners and the manual set", fontsize=style.FONT_PT, loc="left")
    style.legend_below(figure, whole, 3)
    style.headline(figure, title)
    return figure


def _draw_points(axes: Axes, points: Sequence[WinnerPoint], manual: WinnerPoint) -> None:
    edge: dict[str, Any] = {"linestyle": "", "markeredgecolor": "white", "markeredgewidth": 1.0, "clip_on": True}
    for k, point in enumerate(points):
        axes.plot(
            [point.x], [point.y], marker=MARKERS[point.is_first_family], markersize=12.0,
            color=COLOURS[k % len(COLOURS)],
            label=f"{point.label}: {point.score:.4f}", zorder=4, alpha=0.9, **edge,
        )  # fmt: skip
    axes.plot(
        [manual.x], [manual.y], marker="D", markersize=13.0, color=style.MANUAL.colour, zorder=5,
        label=f"manual: {manual.score:.4f}", **edge,
    )  # fmt: skip


def _zoom(axes: Axes, points: Sequence[WinnerPoint], sides: tuple[Side, Side]) -> None:
    for which, (_, box) in zip("xy", sides, strict=True):
        values = [getattr(point, which) for point in points]
        low, high = min(values), max(values)
        if low == high:
            low, high = (low / 1.2, high * 1.2) if box.log else (low - 0.05, high + 0.05)
        getattr(axes, f"set_{which}lim")(*_wider(low, high, box.log, 0.25))
        if box.log:
            style.plain_numbers(getattr(axes, f"{which}axis"), narrow=high < 10.0 * low)


def _wider(low: float, high: float, is_log: bool, share: float) -> tuple[float, float]:
    """A range with a margin on both sides, a share of it on its scale."""
    if is_log:
        factor = (high / low) ** share
        return low / factor, high * factor
    return low - share * (high - low), high + share * (high - low)
