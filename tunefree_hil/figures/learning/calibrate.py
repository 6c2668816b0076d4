"""Figures of a calibration: each channel's command, output and fit; free runs with and without the fitted constants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
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


class Stretch(NamedTuple):
    """Stamps, command, reported output (NaN where none came) and fit."""

    time_s: Numbers
    command: Numbers
    output: Numbers
    fit: Numbers


class Channel(NamedTuple):
    """A by-wire channel: its name, a line that says what was found, and one stretch or more."""

    name: str
    words: str
    stretches: Sequence[Stretch]


class Growth(NamedTuple):
    """RMS error of free runs over time, by target: before and after the fit, each [m]."""

    time_s: Numbers
    before: Mapping[str, Numbers]
    after: Mapping[str, Numbers]
    windows: int


def write_channels(path: Path, channels: Sequence[Channel], title: str) -> Path:
    """Write the figure of `draw_channels` to `path` as PNG."""
    return style.save(draw_channels(channels, title), path)


def write_growth(path: Path, growth: Growth, title: str) -> Path:
    """Write the figure of `draw_growth` to `path` as PNG."""
    return style.save(draw_growth(growth, title), path)


def draw_channels(channels: Sequence[Channel], title: str) -> Figure:
    """A row a channel: a long stretch, and a short one in which dead time and lag can be seen."""
    shown = [channel for channel in channels if channel.stretches]
    figure = style.new_figure(14.0, 1.3 + ROW_IN * max(len(shown), 1))
    style.headline(figure, title)
    if not shown:
        style.say_missing(figure.add_subplot(), "pairs of command and output")
        return figure
    wide = max(len(channel.stretches) for channel in shown)
    grid = figure.add_gridspec(len(shown), wide, width_ratios=[2.0] + [1.0] * (wide - 1))
    axes: Axes | None = None
    for row, channel in enumerate(shown):
        for column, stretch in enumerate(channel.stretches):
            axes = figure.add_subplot(grid[row, column])
            title_here = f"{channel.name}: {channel.words}" if column == 0 else ""
            _draw_stretch(axes, stretch)
            last = row == len(shown) - 1
            style.dress(
                axes, "time (s)" if last else "", UNITS.get(channel.name, "") if column == 0 else "", title_here
            )
    if axes is not None:
        style.legend_below(figure, axes, 3)
    return figure


def _draw_stretch(axes: Axes, stretch: Stretch) -> None:
    heard = np.isfinite(stretch.output)
    axes.step(stretch.time_s, stretch.command, where="post", color=style.FAINT, linewidth=1.4, label="command")
    axes.plot(
        stretch.time_s[heard], stretch.output[heard], color=style.INK, marker=".", markersize=4, linestyle="",
        label="output as reported",
    )  # fmt: skip
    style.line(axes, stretch.time_s, stretch.fit, style.TUNED._replace(width=1.8), "output as fitted")


def draw_growth(growth: Growth, title: str) -> Figure:
    """A panel a target: how the error of a free run grows."""
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
