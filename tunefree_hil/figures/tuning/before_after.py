"""Manual and tuned gains on every verified road, and in time on the road where the difference is largest."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from tunefree_hil.figures import style
from tunefree_hil.figures.scenario import DEG_PER_RAD, DrivePicture, Panel, column
from tunefree_hil.grade.metrics import rms
from tunefree_hil.grade.requirements.limits import CRITERIA

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

START_S = CRITERIA.start_s  # before it a start beside the road counts, whatever the gains are
ERRORS = (
    Panel("lateral_error_m", "lateral error, RMS (m)", 1.0),
    Panel("station_error_m", "station error, RMS (m)", 1.0),
    Panel("speed_error_mps", "speed error, RMS (m/s)", 1.0),
)
IN_TIME = (
    Panel("lateral_error_m", "lateral\nerror (m)", 1.0),
    Panel("station_error_m", "station\nerror (m)", 1.0),
    Panel("cmd_steer_rad", "steering\nwheel (°)", DEG_PER_RAD),
    Panel("accel_mps2", "acceler.\n(m/s²)", 1.0, "ref_accel_mps2"),
)
ROW_IN = 0.3  # height of a road


class RoadPair(NamedTuple):
    """One road, driven with the manual and with the tuned gains."""

    road: str
    manual: DrivePicture
    tuned: DrivePicture


def draw_before_after(pairs: Sequence[RoadPair]) -> Figure:
    """A row a road with its three errors at the left; four signals of one road at the right.

    Args:
        pairs: One or more roads. The labels of the drives begin with "manual" and "tuned".
    """
    figure = style.new_figure(16.0, max(8.0, 3.0 + ROW_IN * len(pairs)))
    grid = figure.add_gridspec(len(IN_TIME), len(ERRORS) + 1, width_ratios=(1.0, 1.0, 1.0, 2.2))
    labels = (pairs[0].manual.label, pairs[0].tuned.label)
    series = style.looks(labels)
    for k, panel in enumerate(ERRORS):
        axes = figure.add_subplot(grid[:, k])
        _draw_roads(axes, panel, pairs, series)
        if k:
            axes.set_yticklabels([])
        else:
            style.legend_below(figure, axes, 2)
    shown = max(pairs, key=_improvement)
    for row, panel in enumerate(IN_TIME):
        axes = figure.add_subplot(grid[row, len(ERRORS)])
        _draw_in_time(axes, panel, shown, series)
        title = f"largest difference:\n{shown.road}" if row == 0 else ""
        style.dress(axes, "time (s)" if row == len(IN_TIME) - 1 else "", panel.label, title)
        axes.tick_params(labelbottom=row == len(IN_TIME) - 1)
    style.headline(figure, _sentence(pairs))
    return figure


def rms_after_start(drive: DrivePicture, name: str) -> float:
    """Root mean square of a column from START_S on, as in the metrics; NaN where it was not recorded."""
    time_s, values = column(drive, "t_s"), column(drive, name)
    if time_s is None or values is None:
        return math.nan
    late = rms(values[time_s >= START_S])
    return math.nan if late is None else late


def mean_errors(drives: Sequence[DrivePicture]) -> dict[str, float]:
    """By column of ERRORS, the mean RMS over the drives that have it; NaN where none has."""
    found = {panel.column: [rms_after_start(drive, panel.column) for drive in drives] for panel in ERRORS}
    known = {name: [value for value in values if math.isfinite(value)] for name, values in found.items()}
    return {name: sum(values) / len(values) if values else math.nan for name, values in known.items()}


def _improvement(pair: RoadPair) -> float:
    """Product of the three error ratios, manual over tuned, as a logarithm; least where nothing was recorded."""
    total = 0.0
    for panel in ERRORS:
        manual, tuned = rms_after_start(pair.manual, panel.column), rms_after_start(pair.tuned, panel.column)
        if manual > 0.0 and tuned > 0.0:
            total += math.log(manual / tuned)
    return total


def _sentence(pairs: Sequence[RoadPair]) -> str:
    manual, tuned = mean_errors([pair.manual for pair in pairs]), mean_errors([pair.tuned for pair in pairs])
    parts = []
    for panel, unit in zip(ERRORS, ("m", "m", "m/s"), strict=True):
        before, after = manual[panel.column], tuned[panel.column]
        if math.isfinite(before) and math.isfinite(after):
            name = panel.label.partition(" ")[0]
            parts.append(f"{name} {style.number(before)} -> {style.number(after)} {unit}")
    return f"RMS errors, mean of {len(pairs)} unseen roads: {', '.join(parts) or 'not recorded'}"


def _draw_roads(axes: Axes, panel: Panel, pairs: Sequence[RoadPair], series: Mapping[str, style.Look]) -> None:
    """A dot for each drive, a line between the two of a road."""
    rows = range(len(pairs))
    values = {
        label: [rms_after_start(drive, panel.column) for drive in drives]
        for label, drives in zip(series, ([pair.manual for pair in pairs], [pair.tuned for pair in pairs]), strict=True)
    }
    manual, tuned = values.values()
    axes.hlines(rows, manual, tuned, color=style.FAINT, linewidth=1.5)
    for label, numbers in values.items():
        look = series[label]
        axes.plot(numbers, rows, look.marker, color=look.colour, markersize=7.0, linestyle="none", label=label)
    style.dress(axes, panel.label, "")
    style.name_bars(axes, [pair.road for pair in pairs])
    axes.set_xlim(left=0.0)


def _draw_in_time(axes: Axes, panel: Panel, pair: RoadPair, series: Mapping[str, style.Look]) -> None:
    reference = column(pair.tuned, panel.reference) if panel.reference else None
    time_s = column(pair.tuned, "t_s")
    if reference is not None and time_s is not None:
        style.line(axes, time_s, reference * panel.factor, style.REFERENCE)
    drawn = False
    for drive in (pair.manual, pair.tuned):
        time_s, values = column(drive, "t_s"), column(drive, panel.column)
        if time_s is not None and values is not None:
            drawn = True
            style.line(axes, time_s, values * panel.factor, series[drive.label]._replace(width=1.4))
    if not drawn:
        style.say_missing(axes, panel.label.replace("\n", " "))
