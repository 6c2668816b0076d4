"""Transfer of gains from a learned plant to the vehicle: grades of the same gain sets on both, one panel a vehicle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style
from tunefree_hil.figures.learning.training import kind_looks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Numbers = NDArray[np.float64]
LEADING = "hybrid"  # drawn last, over the others


class TransferGrades(NamedTuple):
    """Grades of gain sets on a plant and on the vehicle; rho: rank correlation of the sets that finish on both."""

    model: Numbers
    vehicle: Numbers
    rho: float


def draw_transfer(vehicles: Mapping[str, Mapping[str, TransferGrades]]) -> Figure:
    """Draw the grade on the plant over the grade on the vehicle, both on a log scale.

    vehicles: by vehicle, by kind of plant; at least one of each. A set that is not graded on both is left out.
    """
    figure = style.new_figure(6.5 * len(vehicles) + 1.0, 6.4)
    for place, (name, kinds) in enumerate(vehicles.items()):
        axes = figure.add_subplot(1, len(vehicles), place + 1)
        _panel(axes, kinds)
        rhos = ", ".join(f"{kind} {ranked.rho:.2f}" for kind, ranked in kinds.items())
        style.dress(axes, f"grade on the vehicle, {name}", "grade on the plant", f"rank correlation: {rhos}")
    style.legend_below(figure, figure.axes[0], 6)
    style.headline(figure, _sentence(vehicles))
    return figure


def _panel(axes: Axes, kinds: Mapping[str, TransferGrades]) -> None:
    looks = kind_looks(list(kinds))
    for kind in sorted(kinds, key=lambda one: one == LEADING):
        ranked, look = kinds[kind], looks[kind]
        dots = axes.scatter(ranked.vehicle, ranked.model, s=22, alpha=0.6, linewidths=0, marker=look.marker)
        dots.set(color=look.colour, label=kind)
    shown = np.concatenate([np.concatenate([one.model, one.vehicle]) for one in kinds.values()])
    ends = [float(np.nanmin(shown)), float(np.nanmax(shown))]
    style.line(axes, ends, ends, style.REFERENCE, "equal")
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        style.plain_numbers(axis)


def _sentence(vehicles: Mapping[str, Mapping[str, TransferGrades]]) -> str:
    leading = [kinds[LEADING].rho for kinds in vehicles.values() if LEADING in kinds]
    if not leading:
        return "Gains on learned plants and on the vehicle"
    return f"Gains rank on the hybrid as on the vehicle: {min(leading):.2f} on the worse of {len(vehicles)}"
