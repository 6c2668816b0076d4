"""Errors on the vehicle: manual sets of the plain and of the improved controller, and the winner of every seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LABELS = {"lateral_m": "lateral error (m)", "station_m": "station error (m)", "speed_mps": "speed error (m/s)"}
SPREAD = 0.16  # width over which the dots of the seeds are spread
SIDE = 0.32  # of the manual sets, left and right of the seeds
HEADROOM = 1.12  # of the axis over the largest error, for its number


class SetErrors(NamedTuple):
    """One error on one vehicle: best manual set of each controller, and one value a seed."""

    plain: float
    improved: float
    tuned: Sequence[float]


def draw_errors(panels: Mapping[str, Mapping[str, SetErrors]], ratios: Mapping[str, float]) -> Figure:
    """Draw one panel for each error.

    Args:
        panels: Errors by their name (LABELS), by vehicle.
        ratios: Tuned over plain manual by vehicle, for the title.
    """
    figure = style.new_figure(1.0 + 4.6 * len(panels), 5.4)
    for place, (name, vehicles) in enumerate(panels.items()):
        axes = figure.add_subplot(1, len(panels), place + 1)
        for column, errors in enumerate(vehicles.values()):
            _draw_vehicle(axes, column, errors)
        style.dress(axes, "", LABELS[name])
        axes.set_xticks(range(len(vehicles)), list(vehicles))
        axes.set_xlim(-0.6, len(vehicles) - 0.4)
        axes.set_ylim(0.0, HEADROOM * max(max(one.plain, one.improved, *one.tuned) for one in vehicles.values()))
    style.legend_below(figure, figure.axes[0], 3)
    said = ", ".join(f"{vehicle} {ratio:.2f}" for vehicle, ratio in ratios.items())
    style.headline(figure, f"Errors on the vehicle, tuned over plain manual: {said}")
    return figure


def _draw_vehicle(axes: Axes, column: int, errors: SetErrors) -> None:
    places = column + np.linspace(-SPREAD, SPREAD, len(errors.tuned)) if len(errors.tuned) > 1 else [column]
    rows = (
        ([column - SIDE], [errors.plain], style.MANUAL, "manual, plain controller"),
        (places, errors.tuned, style.TUNED, "tuned, one dot a seed"),
        ([column + SIDE], [errors.improved], style.OTHERS[0], "manual, same controller as tuned"),
    )
    for x, y, look, label in rows:
        axes.plot(
            x, y, linestyle="", marker=look.marker, markersize=9.0, color=look.colour, markeredgecolor="white",
            label=label if column == 0 else "_",
        )  # fmt: skip
        middle = float(np.median(y))
        axes.annotate(
            style.number(middle), (float(np.mean(x)), max(y)), xytext=(0, 9), textcoords="offset points", ha="center",
            fontsize=style.FONT_PT - 3, color=style.INK,
        )  # fmt: skip
