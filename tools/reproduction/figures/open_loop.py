"""Data and braking surface of an open-loop map (paper, Fig. 4)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tunefree_hil.figures import style
from tunefree_hil.figures.learning.map import ACCEL_COLOURS, MapPicture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

VIEW_DEG = (24.0, -128.0)  # elevation and azimuth, from which no part of a braking surface hides another
DOT = 4.0


def draw_open_loop(picture: MapPicture) -> Figure:
    """Draw the samples at the left (a), the braking half of the map as a surface at the right (b)."""
    figure = style.new_figure(15.0, 6.8)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.05))
    _draw_samples(figure, figure.add_subplot(grid[0, 0]), picture)
    _draw_surface(figure.add_subplot(grid[0, 1], projection="3d"), picture)
    low = float(picture.grid_accel_mps2.min())
    count = f"{picture.speed_mps.size} samples"
    style.headline(figure, f"Open-loop mapping: {count}; the learned braking surface reaches {style.number(low)} m/s²")
    return figure


def _draw_samples(figure: Figure, axes: Axes, picture: MapPicture) -> None:
    """Speed over signed command; brake left, throttle right."""
    limit = float(np.quantile(np.abs(picture.accel_mps2), 0.98)) if picture.accel_mps2.size else 1.0
    dots = axes.scatter(
        picture.command_frac, picture.speed_mps, c=picture.accel_mps2, s=DOT, cmap=ACCEL_COLOURS, vmin=-limit,
        vmax=limit, linewidths=0.0,
    )  # fmt: skip
    style.dress(axes, "command (duty; brake negative)", "speed (m/s)", "(a) data distribution")
    bar = figure.colorbar(dots, ax=axes, pad=0.01)
    bar.set_label("acceleration (m/s²)", fontsize=style.FONT_PT)
    bar.ax.tick_params(labelsize=style.FONT_PT - 1.5)


def _draw_surface(axes: Any, picture: MapPicture) -> None:
    """Acceleration over brake command and speed; parts without data under them are pale."""
    braking = picture.grid_command_frac <= 0.0
    duty = np.maximum(np.abs(picture.grid_command_frac[braking]), picture.rest_frac)  # command 0: at rest
    accel, backed = picture.grid_accel_mps2[:, braking], picture.support[:, braking] == 1.0
    across, along = np.meshgrid(duty, picture.grid_speed_mps)
    surface = {"cmap": "viridis", "linewidth": 0.3, "edgecolor": "#555555", "rstride": 1, "cstride": 1}
    axes.plot_surface(across, along, np.where(backed, accel, np.nan), **surface)
    axes.plot_wireframe(across, along, accel, color=style.FAINT, linewidth=0.5, alpha=0.5)
    axes.view_init(*VIEW_DEG)
    axes.set_xlabel("brake command (duty)", fontsize=style.FONT_PT, labelpad=8)
    axes.set_ylabel("speed (m/s)", fontsize=style.FONT_PT, labelpad=8)
    axes.set_zlabel("acceleration (m/s²)", fontsize=style.FONT_PT, labelpad=6)
    axes.set_title("(b) mapping result, braking; grey mesh: no data", fontsize=style.FONT_PT, loc="left")
