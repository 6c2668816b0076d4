"""Figures of a calibration: command, output and fit of each channel; free-run errors before and after the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Numbers = NDArray[np.float64]
UNITS = {
    "throttle": "duty",
    "brake": "duty",
    "steer": "steering wheel (rad)",
    "accel": "m/s²",
    "steer_torque": "Nm",
}
AXES = {
    "speed_mps": "speed (m/s)",
    "yaw_rate_radps": "yaw rate (rad/s)",
    "heading_rad": "heading (rad)",
    "lateral_accel_mps2": "lateral acceleration (m/s²)",
    "x_m": "x (m)",
    "y_m": "y (m)",
}
ROW_IN = 3.2


class ChannelTrace(NamedTuple):
    """Time, command, reported output (NaN without a report) and fit, each of shape (n_rows,)."""

    time_s: Numbers
    command: Numbers
    output: Numbers
    fit: Numbers


class ChannelFit(NamedTuple):
    """A by-wire channel: its name, a line with the fitted parameters, and one trace or more."""

    name: str
    text: str
    traces: Sequence[ChannelTrace]


class ErrorGrowth(NamedTuple):
    """RMS error of free runs over time by target, before and after the fit, each of shape (n_rows,)."""

    time_s: Numbers
    before: Mapping[str, Numbers]
    after: Mapping[str, Numbers]
    windows: int


def draw_channels(channels: Sequence[ChannelFit], title: str) -> Figure:
    """Draw a row for each channel: a long trace, and a short one that shows dead time and lag."""
    shown = [channel for channel in channels if channel.traces]
    figure = style.new_figure(14.0, 1.3 + ROW_IN * max(len(shown), 1))
    style.headline(figure, title)
    if not shown:
        style.say_missing(figure.add_subplot(), "pairs of command and output")
        return figure
    wide = max(len(channel.traces) for channel in shown)
    grid = figure.add_gridspec(len(shown), wide, width_ratios=[2.0] + [1.0] * (wide - 1))
    axes: Axes | None = None
    for row, channel in enumerate(shown):
        for column, trace in enumerate(channel.traces):
            axes = figure.add_subplot(grid[row, column])
            panel_title = f"{channel.name}: {channel.text}" if column == 0 else ""
            _draw_trace(axes, trace)
            last = row == len(shown) - 1
            style.dress(
                axes, "time (s)" if last else "", UNITS.get(channel.name, "") if column == 0 else "", panel_title
            )
    if axes is not None:
        style.legend_below(figure, axes, 3)
    return figure


def _draw_trace(axes: Axes, trace: ChannelTrace) -> None:
    is_reported = np.isfinite(trace.output)
    axes.step(trace.time_s, trace.command, where="post", color=style.FAINT, linewidth=1.4, label="command")
    dots = {"color": style.INK, "marker": ".", "markersize": 4, "linestyle": "", "label": "output as reported"}
    axes.plot(trace.time_s[is_reported], trace.output[is_reported], **dots)
    style.line(axes, trace.time_s, trace.fit, style.TUNED._replace(width=1.8), "output as fitted")


def draw_growth(growth: ErrorGrowth, title: str) -> Figure:
    """Draw a panel for each target: the growth of the free-run error."""
    names = [name for name in AXES if name in growth.after]
    columns = min(3, max(len(names), 1))
    rows = max(-(-len(names) // columns), 1)
    figure = style.new_figure(14.0, 1.5 + ROW_IN * rows)
    style.headline(figure, title)
    axes: Axes | None = None
    for i, name in enumerate(names):
        axes = figure.add_subplot(rows, columns, i + 1)
        style.line(axes, growth.time_s, growth.before[name], style.MANUAL, "data sheet")
        style.line(axes, growth.time_s, growth.after[name], style.TUNED, "fitted")
        axes.set_ylim(bottom=0.0)
        style.dress(axes, "time since the start (s)" if i >= len(names) - columns else "", f"error of {AXES[name]}")
    if axes is not None:
        style.legend_below(figure, axes, 2)
    return figure
