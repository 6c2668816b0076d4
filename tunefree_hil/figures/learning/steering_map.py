"""Figure of a learned steering map: wheel angle over curvature at several speeds, with fit and interval."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Numbers = NDArray[np.float64]
SPEED_COLOURS = "viridis"
DEGREES = 180.0 / np.pi


class SteeringCurve(NamedTuple):
    """The map at one speed, with the samples near it.

    Sample arrays have the shape (n_samples,), curve arrays (n_points,). low_rad, high_rad: ends of the 95 % interval.
    neutral_rad: wheel angle of the same map without understeer.
    """

    speed_mps: float
    sample_curvature_1pm: Numbers
    sample_wheel_rad: Numbers
    curvature_1pm: Numbers
    wheel_rad: Numbers
    low_rad: Numbers
    high_rad: Numbers
    neutral_rad: Numbers


def write_steering_picture(path: Path, curves: Sequence[SteeringCurve], title: str) -> Path:
    """Write the figure of `draw_steering` to `path` as PNG."""
    return style.save(draw_steering(curves, title), path)


def draw_steering(curves: Sequence[SteeringCurve], title: str) -> Figure:
    """Left: wheel angle over curvature. Right: its share of understeer, over lateral acceleration."""
    from matplotlib import colormaps

    figure = style.new_figure(14.0, 7.0)
    whole, beyond = figure.subplots(1, 2)
    colours = colormaps[SPEED_COLOURS](np.linspace(0.0, 0.9, max(len(curves), 1)))
    for curve, colour in zip(curves, colours, strict=False):
        nothing = np.zeros(len(curve.curvature_1pm)), np.zeros(len(curve.sample_wheel_rad))
        _draw_curve(whole, curve, colour, 1.0, nothing)
        at_samples = np.interp(curve.sample_curvature_1pm, curve.curvature_1pm, curve.neutral_rad)
        _draw_curve(beyond, curve, colour, curve.speed_mps**2, (curve.neutral_rad, at_samples))
    style.dress(whole, "curvature (1/m)", "steering wheel (deg)", "dots: measured; line: map; band: 95 % interval")
    style.dress(beyond, "lateral acceleration (m/s²)", "", "beyond the same turn without understeer")
    if not curves:
        style.say_missing(whole, "nearly steady turns")
    else:
        whole.legend(title="at m/s", fontsize=style.FONT_PT - 1.5, title_fontsize=style.FONT_PT - 1.5, frameon=False)
    style.headline(figure, title)
    return figure


def _draw_curve(
    axes: Axes, curve: SteeringCurve, colour: Numbers, scale: float, base_rad: tuple[Numbers, Numbers]
) -> None:
    """Samples, line and band of a speed, minus a base of curve and samples, over curvature times `scale`."""
    on_curve, on_samples = base_rad
    measured = (curve.sample_wheel_rad - on_samples) * DEGREES
    axes.scatter(scale * curve.sample_curvature_1pm, measured, s=6.0, color=colour, alpha=0.5, linewidths=0.0)
    low, high, fitted = ((rad - on_curve) * DEGREES for rad in (curve.low_rad, curve.high_rad, curve.wheel_rad))
    axes.fill_between(scale * curve.curvature_1pm, low, high, color=colour, alpha=0.25, linewidth=0.0)
    axes.plot(scale * curve.curvature_1pm, fitted, color=colour, linewidth=1.8, label=f"{curve.speed_mps:.0f}")
