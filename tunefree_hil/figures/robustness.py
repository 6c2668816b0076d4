"""Where a controller fails on many roads: by speed, acceleration and curvature, and by family of roads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.figures import style
from tunefree_hil.figures.scenario import DEG_PER_RAD, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STATES = ("passed", "requirement missed", "stability lost", "undrivable")
PASSED, MISSED, LOST, UNDRIVABLE = STATES
MARKS = {
    PASSED: {"marker": "o", "s": 9, "color": "#c4c4c4", "zorder": 1},
    UNDRIVABLE: {"marker": "s", "s": 34, "facecolors": "none", "edgecolors": style.INK, "zorder": 2},
    MISSED: {"marker": "^", "s": 46, "color": "#e69f00", "zorder": 3},
    LOST: {"marker": "X", "s": 62, "color": "#d55e00", "edgecolors": "white", "linewidths": 0.6, "zorder": 4},
}
AXES = (
    ("peak_lateral_mps2", "peak lateral\nacceleration (m/s²)", "linear"),
    ("peak_longitudinal_mps2", "peak acceleration along\nthe road, slope incl. (m/s²)", "linear"),
    ("peak_curvature_1pm", "peak curvature (1/m);\nstraight roads below", "log"),
)
DRIVE_PANELS = (
    Panel("lateral_error_m", "lateral\nerror (m)", 1.0),
    Panel("station_error_m", "station\nerror (m)", 1.0),
    Panel("speed_mps", "speed\n(m/s)", 1.0, "ref_speed_mps"),
    Panel("accel_mps2", "acceler.\n(m/s²)", 1.0, "ref_accel_mps2"),
    Panel("cmd_steer_rad", "steering\nwheel (°)", DEG_PER_RAD),
)  # of a picture of one drive (figures/scenario.py)
LEAST_CURVATURE_1PM = 1e-4  # a straight road is drawn there, on an axis without 0
ROW_IN = 0.36  # height of a family


class RoadPoint(NamedTuple):
    """A road by what it asks for, and its worst drive's state by label of a set of gains (a text of STATES)."""

    speed_mps: float
    peak_lateral_mps2: float
    peak_longitudinal_mps2: float
    peak_curvature_1pm: float
    states: Mapping[str, str]


class ShareBar(NamedTuple):
    """Failed roads of n, with the interval of their share."""

    failed: int
    n: int
    low: float
    high: float


def draw_failure_map(points: Sequence[RoadPoint], title: str) -> Figure:
    """A column a set of gains; a mark a road, over its top speed.

    Args:
        points: One or more roads, all with the same labels.
    """
    labels = list(points[0].states)
    figure = style.new_figure(7.0 * len(labels) + 0.5, 13.0)
    grid = figure.add_gridspec(len(AXES), len(labels))
    for row, (field, text, scale) in enumerate(AXES):
        for column, label in enumerate(labels):
            axes = figure.add_subplot(grid[row, column])
            axes.set_yscale(scale)
            _draw_points(axes, points, label, field)
            is_last = row == len(AXES) - 1
            style.dress(axes, "top speed of the road (m/s)" if is_last else "", text, "" if row else label)
            if is_last and column == 0:
                style.legend_below(figure, axes, len(STATES))
    style.headline(figure, title)
    return figure


def draw_failure_shares(
    families: Mapping[str, Mapping[str, ShareBar]], sets: Mapping[str, ShareBar], title: str
) -> Figure:
    """Failed roads in percent with their intervals: by family for some sets of gains, and over all roads for each set.

    Args:
        families: By family, then by label of a set of gains.
        sets: By label of a set of gains.
    """
    figure = style.new_figure(15.0, max(6.0, 2.2 + ROW_IN * len(families)))
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    labels = list(next(iter(families.values())))
    series = style.looks(labels)
    for place, label in enumerate(labels):
        shift = 0.3 * (place - 0.5 * (len(labels) - 1))
        _draw_shares(left, [one[label] for one in families.values()], shift, series[label], label)
    style.dress(left, "failed roads (%)", "", "by family of roads")
    style.name_bars(left, [f"{name} ({next(iter(one.values())).n})" for name, one in families.items()])
    style.legend_below(figure, left, len(labels))
    looks = style.looks(list(sets))
    for row, (label, bar) in enumerate(sets.items()):
        _draw_shares(right, [bar], float(row), looks[label], "")
        right.annotate(f" {bar.failed} of {bar.n}", (100.0 * bar.high, row), fontsize=style.FONT_PT - 2.0, va="center")
    style.dress(right, "failed roads (%), 95 % interval", "", "all roads")
    style.name_bars(right, list(sets))
    for axes in (left, right):
        most = axes.get_xlim()[1]
        axes.set_xlim(-0.02 * most, 1.15 * most)
    style.headline(figure, title)
    return figure


def _draw_points(axes: Axes, points: Sequence[RoadPoint], label: str, field: str) -> None:
    for state in MARKS:
        chosen = [point for point in points if point.states[label] == state]
        y = [max(getattr(point, field), LEAST_CURVATURE_1PM) for point in chosen]
        axes.scatter([point.speed_mps for point in chosen], y, label=state, **MARKS[state])
    counts = {state: sum(point.states[label] == state for point in points) for state in STATES[1:]}
    text = ", ".join(f"{count} {state}" for state, count in counts.items() if count) or "none failed"
    axes.annotate(
        f"{text}; {len(points)} roads", (0.02, 0.97), xycoords="axes fraction", va="top", fontsize=style.FONT_PT - 2.0
    )
    low, high = axes.get_ylim()
    # room for the text above
    axes.set_ylim(low, 2.5 * high if axes.get_yscale() == "log" else high + 0.12 * (high - low))


def _draw_shares(axes: Axes, bars: Sequence[ShareBar], first_row: float, look: style.Look, label: str) -> None:
    rows = first_row + np.arange(len(bars))
    middle = [100.0 * bar.failed / max(bar.n, 1) for bar in bars]
    axes.hlines(
        rows, [100.0 * bar.low for bar in bars], [100.0 * bar.high for bar in bars], color=look.colour, linewidth=2.0
    )
    axes.plot(middle, rows, look.marker, color=look.colour, markersize=7.0, linestyle="none", label=label or "_")
