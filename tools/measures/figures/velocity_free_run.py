"""Figure of free runs on recorded drives: speed and yaw rate, measured and simulated by each model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.figures import style
from tunefree_hil.figures.learning.training import kind_looks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROW_IN, COLUMN_IN = 2.9, 5.4


class VelocityRun(NamedTuple):
    """One free run: title, time from its start, measured and simulated values, each of shape (n_rows,)."""

    title: str
    time_s: Any
    speed_mps: Any
    yaw_rate_radps: Any
    speeds: Mapping[str, Any]
    yaw_rates: Mapping[str, Any]


def draw_runs(runs: Sequence[VelocityRun], title: str) -> Figure:
    """Draw a column for each run: speed above, yaw rate below."""
    figure = style.new_figure(max(COLUMN_IN * len(runs), 9.0), 2.0 * ROW_IN + 1.6)
    style.headline(figure, title)
    if not runs:
        style.say_missing(figure.add_subplot(), "free runs")
        return figure
    looks = kind_looks(list(dict.fromkeys(name for run in runs for name in run.speeds)))
    first: Any = None
    for column, run in enumerate(runs):
        for row, (measured, models, label) in enumerate(
            (
                (run.speed_mps, run.speeds, "speed (m/s)"),
                (run.yaw_rate_radps, run.yaw_rates, "yaw rate (rad/s)"),
            )
        ):
            axes = figure.add_subplot(2, len(runs), row * len(runs) + column + 1)
            style.line(axes, run.time_s, measured, style.REFERENCE, "measured")
            for name, values in models.items():
                style.line(axes, run.time_s, values, looks[name], name)
            style.dress(axes, "free run (s)" if row else "", label if column == 0 else "", "" if row else run.title)
            if first is None:
                first = axes
    style.legend_below(figure, first, 1 + len(looks))
    return figure
