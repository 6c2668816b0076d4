"""Two objectives of all trials: the front, the manual sets and the winner, on logarithmic axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EDGE_RATIO = 1.06  # space around the outermost points
MAX_RATIO = 1.5  # of the largest value of front, manual sets and winner: what lies beyond is counted, not drawn
NARROW_RATIO = 8.0  # of an axis: with a smaller range every digit is a tick
LABEL_STEP = 0.035  # of the height of the axes: least distance of two labels one above the other
LETTER_WIDTH = 0.0105  # of the width of the axes
Point = tuple[float, float]


class FrontPicture(NamedTuple):
    """What is drawn; every point has the first objective and the second one.

    is_met: Whether the trial meets the requirements. reference: The manual set that the winner is compared with.
    """

    trials: Sequence[Point]
    is_met: Sequence[bool]
    front: Sequence[Point]
    manual: Mapping[str, Point]
    reference: str
    winner: Point


def draw_front(picture: FrontPicture, labels: tuple[str, str], title: str) -> Figure:
    """Draw the picture. labels: of the two axes."""
    figure = style.new_figure(11.0, 7.5)
    axes = figure.add_subplot()
    axes.set_xscale("log")
    axes.set_yscale("log")
    limits = _limits(picture)
    axes.set_xlim(*limits[0])
    axes.set_ylim(*limits[1])
    _draw_better_region(axes, picture)
    beyond = _draw_trials(axes, picture, limits)
    _draw_line(axes, picture, limits)
    style.dress(axes, *labels, f"{beyond} trials lie beyond the picture" if beyond else "")
    for axis, (low, high) in zip((axes.xaxis, axes.yaxis), limits, strict=True):
        style.plain_numbers(axis, narrow=high < NARROW_RATIO * low)
    _name_manual_sets(axes, picture, limits)
    style.legend_below(figure, axes, 3)
    style.headline(figure, title)
    return figure


def _limits(picture: FrontPicture) -> list[Point]:
    """The limits of both axes: around front, manual sets and winner, and wider for trials that are not far from them.

    A failed drive is so far away that it would leave no room for the others.
    """
    limits = []
    for k in range(2):
        core = [point[k] for point in (*picture.front, *picture.manual.values(), picture.winner) if point[k] > 0.0]
        largest = MAX_RATIO * max(core)
        shown = core + [point[k] for point in picture.trials if 0.0 < point[k] <= largest]
        limits.append((min(shown) / EDGE_RATIO, max(shown) * EDGE_RATIO))
    return limits


def _draw_better_region(axes: Axes, picture: FrontPicture) -> None:
    """Shade what is better than the reference in both objectives."""
    x, y = picture.manual[picture.reference]
    label = f"better than {picture.reference} in both"
    axes.fill_between([axes.get_xlim()[0], x], axes.get_ylim()[0], y, color="#e8f1e4", zorder=0, label=label)


def _draw_trials(axes: Axes, picture: FrontPicture, limits: Sequence[Point]) -> int:
    """Draw the trials, hollow where they violate requirements; returns how many lie outside the limits."""
    points, is_met = np.asarray(picture.trials, dtype=np.float64), np.asarray(picture.is_met, dtype=bool)
    inside = np.all([(points[:, k] >= limits[k][0]) & (points[:, k] <= limits[k][1]) for k in range(2)], axis=0)
    for chosen, face, label in (
        (inside & ~is_met, "none", "trial that violates a requirement"),
        (inside & is_met, style.FAINT, "trial" if is_met.all() else "trial that meets all requirements"),
    ):
        if chosen.any():
            axes.scatter(*points[chosen].T, s=42.0, facecolors=face, edgecolors=style.FAINT, zorder=2, label=label)
    return int(np.count_nonzero(~inside))


def _draw_line(axes: Axes, picture: FrontPicture, limits: Sequence[Point]) -> None:
    """The front as a staircase, since what lies between two of its trials is not known, and the winner."""
    x, y = np.asarray(picture.front, dtype=np.float64).T
    stair_x, stair_y = [x[0], *x, limits[0][1]], [limits[1][1], *y, y[-1]]
    colour = style.TUNED.colour
    axes.step(stair_x, stair_y, where="post", color=colour, linewidth=1.8, zorder=3)
    axes.plot(x, y, "o", color=colour, markersize=7.0, zorder=4, label=f"Pareto front, {len(x)} trials")
    star = {"marker": "*", "markersize": 22.0, "color": colour, "markeredgecolor": "white", "markeredgewidth": 1.5}
    axes.plot(*picture.winner, linestyle="", zorder=6, label="winner", **star)


def _name_manual_sets(axes: Axes, picture: FrontPicture, limits: Sequence[Point]) -> None:
    """Diamonds with their names beside them; names that would overlap are moved down."""
    from matplotlib.patheffects import withStroke

    places = {name: _place(point, limits) for name, point in picture.manual.items()}
    look = style.MANUAL
    diamonds = {"color": look.colour, "markersize": 9.0, "zorder": 5, "label": "manual set"}
    axes.plot(*zip(*picture.manual.values(), strict=True), "D", **diamonds)
    written: list[LabelBox] = []
    for name in sorted(places, key=lambda name: -places[name][1]):
        x, y = places[name]
        width = LETTER_WIDTH * (len(name) + 2)
        is_right = x + width < 1.0  # else the name would leave the picture
        box = LabelBox(x if is_right else x - width, x + width if is_right else x, y)
        while any(box.overlaps(other) for other in written):
            box = box._replace(y=box.y - 0.2 * LABEL_STEP)
        written.append(box)
        axes.annotate(
            name,
            (x, box.y),
            xycoords="axes fraction",
            xytext=(9.0 if is_right else -9.0, 0.0),
            textcoords="offset points",
            ha="left" if is_right else "right",
            va="center",
            fontsize=style.FONT_PT - 1.0,
            color=look.colour,
            zorder=7,
            path_effects=[withStroke(linewidth=3.0, foreground="white")],
        )


class LabelBox(NamedTuple):
    """Where a label is written: its left and right end and its middle, as shares of the axes."""

    left: float
    right: float
    y: float

    def overlaps(self, other: LabelBox) -> bool:
        """Whether both labels would be written over each other."""
        return self.left < other.right and other.left < self.right and abs(self.y - other.y) < LABEL_STEP


def _place(point: Point, limits: Sequence[Point]) -> Point:
    """The place of a point in the axes, 0 to 1 each."""
    x, y = (
        float(np.log(max(value, low) / low) / np.log(high / low))
        for value, (low, high) in zip(point, limits, strict=True)
    )
    return x, y
