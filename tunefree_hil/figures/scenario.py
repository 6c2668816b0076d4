"""One scenario, driven with two or more sets of parameters (paper, Fig. 11): path, errors, speed, steering."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tunefree_hil.figures import style
from tunefree_hil.grade.score import FINISHED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DEG_PER_RAD = 180.0 / np.pi
KPH_PER_MPS = 3.6
REPLAN_M = 0.5  # the follower re-plans above this lateral error (docs/reference/grading.md)
STRETCH_ABOVE = 5.0  # a path longer than this many times its width has a separate scale for y


class DrivePicture(NamedTuple):
    """One drive: `label` ("manual ...", "tuned ..." keep their colours), columns by the names of
    docs/reference/files.md.

    Columns have one row a tick and may be missing; t_s must be there. outcome: why it ended; '' where unknown.
    """

    label: str
    columns: Mapping[str, Sequence[float] | NDArray[np.float64]]
    score: float | None = None
    outcome: str = ""

    @property
    def early_end(self) -> str:
        """Outcome of a drive that ended early; '' for any other drive."""
        return "" if self.outcome == FINISHED else self.outcome


class Panel(NamedTuple):
    """One signal over time: column, its label, factor to the unit shown, and the column of its reference."""

    column: str
    label: str
    factor: float
    reference: str = ""


PANELS = (
    Panel("lateral_error_m", "lateral\nerror (m)", 1.0),
    Panel("heading_error_rad", "heading\nerror (°)", DEG_PER_RAD),
    Panel("speed_mps", "speed\n(km/h)", KPH_PER_MPS, "ref_speed_mps"),
    Panel("out_steer_rad", "steering\nwheel (°)", DEG_PER_RAD),
)


def draw_scenario(
    name: str, drives: Sequence[DrivePicture], panels: Sequence[Panel] = PANELS, sentence: str = ""
) -> Figure:
    """The path at the left, signals over time at the right; triangles are re-plans, crosses early ends.

    Args:
        sentence: Of the title; '' for the peaks of the lateral error.
    """
    figure = style.new_figure(13.0, 2.0 * max(len(panels), 4))
    grid = figure.add_gridspec(len(panels), 2, width_ratios=(1.0, 1.25))
    series = style.looks([drive.label for drive in drives])
    path = figure.add_subplot(grid[:, 0])
    _draw_path(path, drives, series)
    style.legend_below(figure, path, 3)
    first: Axes | None = None
    for row, panel in enumerate(panels):
        axes = figure.add_subplot(grid[row, 1], sharex=first)
        first = first or axes
        _draw_panel(axes, panel, drives, series)
        style.dress(axes, "time (s)" if row == len(panels) - 1 else "", panel.label)
        axes.tick_params(labelbottom=row == len(panels) - 1)
    style.headline(figure, f"{name}: {sentence or _sentence(drives)}")
    return figure


def column(drive: DrivePicture, name: str) -> NDArray[np.float64] | None:
    """A column as an array; None where the drive has none, or nothing finite in it."""
    if name not in drive.columns:
        return None
    values = np.asarray(drive.columns[name], dtype=np.float64)
    return values if np.isfinite(values).any() else None


def _sentence(drives: Sequence[DrivePicture]) -> str:
    """Peak of the lateral error and re-plans of each drive, in words."""
    parts = []
    for drive in drives:
        error, replans = column(drive, "lateral_error_m"), _replan_rows(drive).size
        peak = "not recorded" if error is None else f"{np.nanmax(np.abs(error)):.2f} m"
        counted = f", {replans} re-plan{'s' if replans > 1 else ''}" if replans else ""
        parts.append(f"{peak} ({drive.label}{counted})")
    return "peak lateral error " + ", ".join(parts)


def _replan_rows(drive: DrivePicture) -> NDArray[np.int64]:
    replan = column(drive, "replan")
    return np.flatnonzero(replan > 0.5) if replan is not None else np.array([], dtype=np.int64)


def _draw_path(axes: Axes, drives: Sequence[DrivePicture], series: Mapping[str, style.Look]) -> None:
    """The path from above; the reference is the current trajectory of the first drive that has one."""
    lines = [(column(drive, "ref_x_m"), column(drive, "ref_y_m")) for drive in drives]
    reference = next(((x, y) for x, y in lines if x is not None and y is not None), None)
    if reference:
        style.line(axes, *reference, style.REFERENCE, "reference")
    for drive in drives:
        x, y = column(drive, "x_m"), column(drive, "y_m")
        if x is None or y is None:
            continue
        score = "" if drive.score is None else f", score {style.number(drive.score)}"
        style.line(axes, x, y, series[drive.label], drive.label + score)
        rows = _replan_rows(drive)
        _mark(axes, x[rows], y[rows], series[drive.label].colour, marker="v", markersize=11.0)
        if drive.early_end:
            label = f"{drive.label}: {drive.early_end}"
            _mark(axes, x[-1:], y[-1:], series[drive.label].colour, marker="X", markersize=12.0, label=label)
    if any(_replan_rows(drive).size for drive in drives):
        _mark(axes, [], [], style.FAINT, marker="v", markersize=11.0, label="re-plan")
    note = _scale(axes)
    style.dress(axes, "x (m)", f"y (m){note}", "path, seen from above")
    if not axes.has_data():
        style.say_missing(axes, "path")


def _scale(axes: Axes) -> str:
    """One scale for x and y, unless the path is too narrow; returns a note about the scale."""
    width, height = np.diff(axes.get_xlim())[0], np.diff(axes.get_ylim())[0]
    if max(width, height) > STRETCH_ABOVE * min(width, height):
        return ", drawn larger than x" if width > height else ", drawn smaller than x"
    axes.set_aspect("equal", adjustable="datalim")
    return ""


def _draw_panel(axes: Axes, panel: Panel, drives: Sequence[DrivePicture], series: Mapping[str, style.Look]) -> None:
    drawn = False
    for drive in drives:
        time_s, values = column(drive, "t_s"), column(drive, panel.column)
        if time_s is None or values is None:
            continue
        drawn, look, shown = True, series[drive.label], values * panel.factor
        style.line(axes, time_s, shown, look)
        rows = _replan_rows(drive)
        _mark(axes, time_s[rows], shown[rows], look.colour, marker="v", markersize=10.0)
        if drive.early_end:
            _mark(axes, time_s[-1:], shown[-1:], look.colour, marker="X", markersize=11.0)
    if not drawn:
        style.say_missing(axes, panel.label.replace("\n", " "))
    _draw_reference(axes, panel, drives)


def _draw_reference(axes: Axes, panel: Panel, drives: Sequence[DrivePicture]) -> None:
    """The reference value where there is one, else zero; the re-plan limits where they are near."""
    longest = max(drives, key=lambda drive: len(drive.columns.get("t_s", ())))
    time_s = column(longest, "t_s")
    wished = column(longest, panel.reference) if panel.reference else None
    if time_s is not None and wished is not None:
        style.line(axes, time_s, wished * panel.factor, style.REFERENCE)
    elif not panel.reference:
        axes.axhline(0.0, color=style.INK, linewidth=0.8)
    low, high = axes.get_ylim()
    if panel.column == "lateral_error_m":
        for limit in (limit for limit in (-REPLAN_M, REPLAN_M) if 1.3 * low <= limit <= 1.3 * high):
            axes.axhline(limit, color=style.FAINT, linestyle=(0, (2, 2)), linewidth=1.4)


def _mark(axes: Axes, x: ArrayLike, y: ArrayLike, colour: str, **marker: Any) -> None:
    axes.plot(x, y, color=colour, linestyle="", markeredgecolor="white", zorder=5, **{"label": "_", **marker})
