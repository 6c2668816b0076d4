"""A set of roads: each one's path, speed, and lateral and longitudinal acceleration over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.episode.feasible import curvature_by_time
from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROW_INCHES = 1.7
WIDTH_INCHES = 14.0
STRETCH_ABOVE = 10.0  # a path longer than this many times its width has a separate scale for y
TITLES = (
    *("path (m)", "speed (m/s)", "curvature (1/m)"),
    *("lateral acceleration (m/s²)", "acceleration (m/s²)", "slope, bank, wind/g (%)", "friction (%)"),
)
LABELS = ("slope", "bank", "wind/g")  # of the panel with several lines


def draw_roads(courses: Mapping[str, Course]) -> Figure:
    """One row a road: path, then what is asked over time, and the road."""
    figure = style.new_figure(WIDTH_INCHES, ROW_INCHES * max(len(courses), 1) + 0.5)
    grid = figure.add_gridspec(len(courses), len(TITLES))
    for row, (name, course) in enumerate(courses.items()):
        for column, (x, *lines) in enumerate(_signals(course)):
            axes = figure.add_subplot(grid[row, column])
            for label, y in zip(LABELS, lines, strict=False):
                axes.plot(x, y, linewidth=1.0, label=label)
            axes.tick_params(labelsize=6)
            if column == 0:
                axes.set_ylabel(name, fontsize=6)
                if np.ptp(x) < STRETCH_ABOVE * np.ptp(lines[0]):
                    axes.set_aspect("equal", adjustable="datalim")
            if row == 0:
                axes.set_title(TITLES[column], fontsize=8)
                if len(lines) > 1:
                    axes.legend(fontsize=6)
    return figure


def _signals(course: Course) -> list[tuple[np.ndarray, ...]]:
    """x of each panel, then what is drawn over it."""
    time = course.dt_s * np.arange(len(course.speed_mps))
    speed, curvature = np.asarray(course.speed_mps), curvature_by_time(course)
    inside = course.first_station_m + course.spacing_m * np.arange(len(course.path_x_m))
    driven = (inside >= 0.0) & (inside <= course.station_m[-1])
    return [
        (np.asarray(course.path_x_m)[driven], np.asarray(course.path_y_m)[driven]),
        (time, speed),
        (time, curvature),
        (time, speed * speed * curvature),
        (time, np.asarray(course.accel_mps2)),
        (
            *(time, 100.0 * np.tan(course.grade_rad), 100.0 * np.tan(course.bank_rad)),
            100.0 / G_MPS2 * np.asarray(course.side_wind_mps2),
        ),
        (time, 100.0 * np.asarray(course.friction_frac)),
    ]
