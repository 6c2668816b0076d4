"""Top view of a vehicle beside its planned path at three moments (paper, Fig. 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Outline of a sedan from the middle of its rear axle, m (Apollo, vehicle_param.pb.txt).
FRONT_M, BACK_M, SIDE_M = 3.89, 1.043, 1.055
VIEW_BEHIND_M, VIEW_AHEAD_M, VIEW_SIDE_M = 9.0, 19.0, 4.2
LANE_HALF_WIDTH_M = 2.0
REPLAN_M = 0.5  # the follower re-plans above this lateral error


class Trace(NamedTuple):
    """One drive: time, pose of the rear axle, lateral error of the centre of mass; one row a tick.

    rear_axle_m: From the rear axle to the centre of mass.
    """

    t_s: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray
    heading_rad: np.ndarray
    lateral_error_m: np.ndarray
    rear_axle_m: float

    @property
    def centre_of_mass(self) -> tuple[np.ndarray, np.ndarray]:
        """x and y of the point that follows the path."""
        return (
            self.x_m + self.rear_axle_m * np.cos(self.heading_rad),
            self.y_m + self.rear_axle_m * np.sin(self.heading_rad),
        )


class Frame(NamedTuple):
    """One picture: title, label of the trace, and its row."""

    title: str
    label: str
    row: int


def draw_side_pass(
    traces: Mapping[str, Trace], frames: Sequence[Frame], path: tuple[np.ndarray, np.ndarray], labels: tuple[str, str]
) -> Figure:
    """Draw a top view a frame, and below them the lateral error over time.

    Args:
        traces: Drives by label.
        frames: The pictures, from the top.
        path: x and y of the planned path, which the centre of mass follows.
        labels: The drive without and the one with MRAC.
    """
    figure = style.new_figure(11.0, 13.0)
    grid = figure.add_gridspec(len(frames) + 1, 1, height_ratios=[*([1.0] * len(frames)), 0.9])
    looks = {labels[0]: style.MANUAL, labels[1]: style.TUNED}
    for k, frame in enumerate(frames):
        axes = figure.add_subplot(grid[k, 0])
        _draw_frame(axes, traces[frame.label], frame, path, looks[frame.label])
        style.dress(axes, "x (m)" if k == len(frames) - 1 else "", "y (m)", frame.title)
    below = figure.add_subplot(grid[len(frames), 0])
    for label, name in zip(labels, ("without MRAC", "with MRAC"), strict=True):
        style.line(below, traces[label].t_s, traces[label].lateral_error_m, looks[label], name)
    for edge in (-REPLAN_M, REPLAN_M):
        below.axhline(edge, color=style.FAINT, linestyle=":", linewidth=1.6)
    below.axvline(traces[labels[0]].t_s[frames[1].row], color=style.FAINT, linewidth=1.2)
    style.dress(
        below, "time (s)", "lateral error (m)", "beyond the dotted lines the path is planned anew; line: (b) and (c)"
    )
    figure.get_layout_engine().set(h_pad=0.06)  # type: ignore[union-attr] - constrained layout
    style.legend_below(figure, below, 2)
    peaks = [float(np.nanmax(np.abs(traces[label].lateral_error_m))) for label in labels]
    style.headline(figure, f"Successive side-pass: lateral peak {peaks[0]:.2f} m without, {peaks[1]:.2f} m with MRAC")
    return figure


def _draw_frame(axes: Axes, trace: Trace, frame: Frame, path: tuple[np.ndarray, np.ndarray], look: style.Look) -> None:
    from matplotlib.patches import Polygon

    row = min(frame.row, len(trace.x_m) - 1)
    x, y = float(trace.x_m[row]), float(trace.y_m[row])
    axes.fill_between(path[0], path[1] - LANE_HALF_WIDTH_M, path[1] + LANE_HALF_WIDTH_M, color="#eeeeee", zorder=0)
    style.line(axes, *path, style.REFERENCE)
    driven = slice(0, row + 1)
    centre_x, centre_y = trace.centre_of_mass
    axes.plot(centre_x[driven], centre_y[driven], color=look.colour, linewidth=2.0, zorder=5)
    axes.plot(centre_x[row : row + 1], centre_y[row : row + 1], marker="o", color=style.INK, markersize=6.0, zorder=6)
    outline = outline_of(x, y, float(trace.heading_rad[row]))
    axes.add_patch(Polygon(outline, closed=True, facecolor=look.colour, edgecolor=style.INK, alpha=0.55, zorder=4))
    axes.set_aspect("equal", adjustable="box")
    middle = float(np.interp(x, path[0], path[1]))
    axes.set_xlim(x - VIEW_BEHIND_M, x + VIEW_AHEAD_M)
    axes.set_ylim(middle - VIEW_SIDE_M, middle + VIEW_SIDE_M)


def outline_of(x_m: float, y_m: float, heading_rad: float) -> np.ndarray:
    """Corners of the vehicle, shape (4, 2)."""
    corners = np.array([(FRONT_M, SIDE_M), (FRONT_M, -SIDE_M), (-BACK_M, -SIDE_M), (-BACK_M, SIDE_M)])
    cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
    return corners @ np.array([[cosine, sine], [-sine, cosine]]) + np.array([x_m, y_m])
