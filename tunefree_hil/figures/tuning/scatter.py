"""The sample points of a study, coloured by score (paper, Fig. 8b and 10)."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_PAIRED = 3  # parameters that are shown in pairs
BINS = 5
MARK: dict[str, Any] = {
    "markeredgecolor": "white",
    "markeredgewidth": 1.5,
    "linestyle": "",
    "zorder": 6,
    "clip_on": False,
}


class ParameterBox(NamedTuple):
    """The range of one parameter, its scale and its unit ("1" and "" are not shown)."""

    low: float
    high: float
    log: bool
    unit: str = ""


class TrialPoints(NamedTuple):
    """What was tried: the parameters by name, one row a trial; scores, lower is better; the boxes by name.

    `manual`: the parameters that the tuned ones are held against; those outside a box are drawn on its edge.
    """

    parameters: Mapping[str, Sequence[float] | NDArray[np.float64]]
    scores: Sequence[float]
    boxes: Mapping[str, ParameterBox]
    manual: Mapping[str, float]


def draw_scatter(points: TrialPoints) -> Figure:
    """One or two parameters: one plane. More: the three that matter most in pairs, and all in parallel coordinates."""
    names = list(points.parameters)
    if len(names) <= 2:
        figure = style.new_figure(9.5, 8.0)
        planes = [figure.add_subplot()]
        _draw_plane(planes[0], points, names[0], names[-1])
    else:
        figure = style.new_figure(14.0, 10.0)
        grid = figure.add_gridspec(2, MAX_PAIRED, height_ratios=(1.0, 1.0))
        leading = rank_parameters(points)[:MAX_PAIRED]
        planes = [figure.add_subplot(grid[0, i]) for i in range(MAX_PAIRED)]
        for axes, (x, y) in zip(planes, itertools.combinations(leading, 2), strict=True):
            _draw_plane(axes, points, x, y)
        below = figure.add_subplot(grid[1, :])
        _draw_parallel(below, points)
        planes.append(below)
    _draw_bar(figure, planes, points)
    style.legend_below(figure, planes[0], 3)
    best = min(points.scores)
    style.headline(figure, f"{len(points.scores)} trials in {len(names)} dimensions, best score {style.number(best)}")
    return figure


def rank_parameters(points: TrialPoints) -> list[str]:
    """The parameters, sorted by `variance_share`, the largest first."""
    return sorted(points.parameters, key=lambda name: -variance_share(points.parameters[name], points.scores))


def variance_share(values: ArrayLike, scores: ArrayLike) -> float:
    """Share (0 to 1) of the variance of the scores' ranks that lies between bins of equal numbers of trials.

    It sees a valley as well as a slope. It is a help to choose what to show, not a measure of sensitivity: with few
    trials chance alone gives about (bins - 1) / (trials - 1).
    """
    ranks = np.argsort(np.argsort(np.asarray(scores, dtype=np.float64))).astype(np.float64)
    total = float(np.sum((ranks - ranks.mean()) ** 2))
    if total == 0.0:
        return 0.0
    parts = np.array_split(ranks[np.argsort(np.asarray(values, dtype=np.float64), kind="stable")], BINS)
    return float(sum(part.size * (part.mean() - ranks.mean()) ** 2 for part in parts if part.size)) / total


def _order(scores: Sequence[float]) -> NDArray[np.int64]:
    """Worst first, so that good trials are drawn on top."""
    return np.argsort(-np.asarray(scores, dtype=np.float64), kind="stable")


def _norm(scores: Sequence[float]) -> Any:
    """Colours over the logarithm of the score of the better three quarters, as failures would use most colours."""
    from matplotlib.colors import LogNorm, Normalize

    low, high = float(np.min(scores)), float(np.quantile(np.asarray(scores, dtype=np.float64), 0.75))
    if low <= 0.0 or high <= low:
        return Normalize(low, max(high, low + 1e-9), clip=True)
    return LogNorm(low, high, clip=True)


def _draw_plane(axes: Axes, points: TrialPoints, x: str, y: str) -> None:
    """The trials in the plane of two parameters; with one parameter only, score upwards."""
    order, scores = _order(points.scores), np.asarray(points.scores, dtype=np.float64)
    across = np.asarray(points.parameters[x], dtype=np.float64)
    up = scores if x == y else np.asarray(points.parameters[y], dtype=np.float64)
    axes.scatter(
        across[order],
        up[order],
        c=scores[order],
        cmap=style.SCORE_COLOURS,
        norm=_norm(points.scores),
        s=52.0,
        edgecolors="white",
        linewidths=0.6,
    )
    best = int(np.argmin(scores))
    if x != y and {x, y} <= points.manual.keys():
        manual = {"marker": "D", "markersize": 12.0, "color": style.MANUAL.colour, "label": "manual"}
        axes.plot([_inside(points, x)], [_inside(points, y)], **manual, **MARK)
    star = {"marker": "*", "markersize": 22.0, "color": style.TUNED.colour, "label": "best"}
    axes.plot([across[best]], [up[best]], **star, **MARK)
    _set_box(axes, points.boxes[x], "x")
    if x != y:
        _set_box(axes, points.boxes[y], "y")
    style.dress(axes, _label(x, points), "score (lower is better)" if x == y else _label(y, points))


def _label(name: str, points: TrialPoints) -> str:
    return style.with_unit(name, points.boxes[name].unit)


def _inside(points: TrialPoints, name: str) -> float:
    return min(max(points.manual[name], points.boxes[name].low), points.boxes[name].high)


def _set_box(axes: Axes, box: ParameterBox, which: str) -> None:
    """Set the limits of an axis a little wider than the range."""
    if box.log:
        getattr(axes, f"set_{which}scale")("log")
        style.plain_numbers(getattr(axes, f"{which}axis"))
        edge = (box.high / box.low) ** 0.04
        getattr(axes, f"set_{which}lim")(box.low / edge, box.high * edge)
    else:
        edge = 0.04 * (box.high - box.low)
        getattr(axes, f"set_{which}lim")(box.low - edge, box.high + edge)


def _place(values: NDArray[np.float64], box: ParameterBox) -> NDArray[np.float64]:
    """Position of each value in its range (0 to 1, on its scale), clipped to the range."""
    inside = np.clip(values, box.low, box.high)
    if box.log:
        return np.log(inside / box.low) / np.log(box.high / box.low)
    return (inside - box.low) / (box.high - box.low)


def _draw_parallel(axes: Axes, points: TrialPoints) -> None:
    """One line a trial across all parameters, each from the lower to the upper edge of its range."""
    from matplotlib import colormaps

    names, norm = list(points.parameters), _norm(points.scores)
    places = np.array([_place(np.asarray(points.parameters[name], np.float64), points.boxes[name]) for name in names])
    positions = np.arange(len(names))
    for row in _order(points.scores):
        badness = float(norm(points.scores[row]))
        colour = colormaps[style.SCORE_COLOURS](badness)
        axes.plot(positions, places[:, row], color=colour, linewidth=1.0, alpha=0.65 - 0.45 * badness)
    shown = [i for i, name in enumerate(names) if name in points.manual]
    manual = [_place(np.array(points.manual[names[i]]), points.boxes[names[i]]) for i in shown]
    look = style.MANUAL
    axes.plot(shown, manual, color=look.colour, linestyle="--", marker="D", markersize=9.0, linewidth=2.6, zorder=5)
    best = places[:, int(np.argmin(points.scores))]
    axes.plot(positions, best, color=style.TUNED.colour, marker="*", markersize=16.0, linewidth=3.2, zorder=6)
    style.dress(axes, "", "position in the range", "all parameters, from the lower to the upper edge of the range")
    axes.set_xticks(positions, [_tick(name, points.boxes[name]) for name in names], fontsize=style.FONT_PT - 2.0)
    axes.set_yticks([0.0, 0.5, 1.0], ["low", "middle", "high"])
    axes.set_xlim(-0.3, len(names) - 0.7)


def _tick(name: str, box: ParameterBox) -> str:
    """The name in two lines, and the range."""
    group, _, last = name.rpartition(".")
    edges = f"{style.number(box.low)} to\n{style.number(box.high)}"
    return f"{group}\n{last}\n{edges}" if group else f"{last}\n\n{edges}"


def _draw_bar(figure: Figure, axes: Sequence[Axes], points: TrialPoints) -> None:
    from matplotlib.cm import ScalarMappable

    colours = ScalarMappable(_norm(points.scores), style.SCORE_COLOURS)
    bar = figure.colorbar(colours, ax=list(axes), extend="max", aspect=35, pad=0.015)
    bar.set_label("score (lower is better)", fontsize=style.FONT_PT)
    bar.ax.tick_params(labelsize=style.FONT_PT - 1.5)
    low, high = colours.get_clim()
    if low is not None and high is not None and low > 0.0:
        style.plain_numbers(bar.ax.yaxis, narrow=high < 10.0 * low)
