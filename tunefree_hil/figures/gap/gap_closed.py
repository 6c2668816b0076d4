"""Figures of a repaired model: errors by variant, traces of a holdout block, the residual with and without effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Numbers = NDArray[np.float64]
LOOKS = {  # by variant
    "before": style.MANUAL,
    "recalibrated": style.OTHERS[2],
    "after": style.TUNED,
    "floor": style.REFERENCE,
}
LABELS = {"before": "original model", "recalibrated": "recalibration only", "after": "repaired", "floor": "floor"}
BAR_IN, PANEL_IN = 0.2, 2.6
MAX_POINTS = 4000


class SignalErrors(NamedTuple):
    """RMS errors of a signal in its unit, by variant; absent variants are left out."""

    name: str
    unit: str
    errors: Mapping[str, float]


class SignalTrace(NamedTuple):
    """A signal over time: measured, and simulated by variant, each of shape (n_rows,)."""

    name: str
    unit: str
    time_s: Numbers
    measured: Numbers
    simulated: Mapping[str, Numbers]


def draw_errors(bars: Sequence[SignalErrors], title: str) -> Figure:
    """Draw a group of bars for each signal, in percent of the error of the original model."""
    variants = [name for name in LOOKS if any(name in bar.errors for bar in bars)]
    figure = style.new_figure(12.0, 2.0 + BAR_IN * max(len(bars), 2) * (len(variants) + 1.2))
    style.headline(figure, title)
    axes = figure.add_subplot()
    if not bars:
        style.say_missing(axes, "free runs")
        return figure
    width = 0.84 / len(variants)
    for row, variant in enumerate(variants):
        for y, signal in enumerate(bars):
            if variant in signal.errors:
                position = y + (row - 0.5 * (len(variants) - 1)) * width
                label = LABELS[variant] if y == 0 else "_"
                _draw_bar(axes, signal, variant, y=position, height=0.92 * width, label=label)
    axes.set_xlim(0.0, 1.25 * max(100.0, *(_percent_of_original(bar, name) for bar in bars for name in bar.errors)))
    style.dress(axes, "error on holdout blocks (RMS, % of the original model)", "")
    style.name_bars(axes, [bar.name for bar in bars])
    style.legend_below(figure, axes, 4)
    return figure


def _percent_of_original(signal: SignalErrors, variant: str) -> float:
    whole = signal.errors["before"]
    return 100.0 * signal.errors[variant] / whole if whole > 0.0 else 0.0


def _draw_bar(axes: Axes, signal: SignalErrors, variant: str, **bar: Any) -> None:
    """Draw a bar with its value and unit behind it; bar: its y, height and label."""
    length = _percent_of_original(signal, variant)
    hatch = "//" if variant == "floor" else ""
    axes.barh(width=length, color=LOOKS[variant].colour, edgecolor="white", hatch=hatch, **bar)
    unit = "" if signal.unit == "1" else f" {signal.unit}"
    text = f" {style.number(signal.errors[variant])}{unit}"
    axes.text(length, bar["y"], text, va="center", fontsize=style.FONT_PT - 4)


def draw_traces(runs: Sequence[SignalTrace], title: str) -> Figure:
    """Draw a panel for each signal: measured, and simulated from the recorded commands alone."""
    figure = style.new_figure(13.0, 1.6 + PANEL_IN * max(len(runs), 1))
    style.headline(figure, title)
    if not runs:
        style.say_missing(figure.add_subplot(), "a holdout block")
        return figure
    panels = figure.subplots(len(runs), 1, sharex=True, squeeze=False)[:, 0]
    for axes, run in zip(panels, runs, strict=True):
        axes.plot(run.time_s, run.measured, color=style.INK, linewidth=3.2, alpha=0.35, label="measured")
        for variant, values in run.simulated.items():
            style.line(axes, run.time_s, values, LOOKS[variant]._replace(width=1.8), LABELS[variant])
        last = run is runs[-1]
        style.dress(axes, "time since the block began (s)" if last else "", style.with_unit(run.name, run.unit))
    style.legend_below(figure, panels[0], 4)
    return figure


def draw_signature(stretch: SignalTrace, whole: SignalTrace, title: str) -> Figure:
    """Draw the residual of a signal with and without the effects: over time in one block, over the signal in all."""
    figure = style.new_figure(14.0, 5.2)
    style.headline(figure, title)
    left, right = figure.subplots(1, 2, width_ratios=[1.5, 1.0])
    for variant, values in stretch.simulated.items():
        look = LOOKS[variant]._replace(width=1.8)
        style.line(left, stretch.time_s, values - stretch.measured, look, LABELS[variant])
    thin = slice(None, None, max(1, len(whole.measured) // MAX_POINTS))
    for variant, values in whole.simulated.items():
        errors = (values - whole.measured)[thin]
        dots = {"linestyle": "", "marker": ".", "markersize": 3, "alpha": 0.5}
        right.plot(whole.measured[thin], errors, color=LOOKS[variant].colour, **dots)
    difference = style.with_unit("simulated - measured", stretch.unit)
    style.dress(left, "time since the block began (s)", difference, stretch.name)
    style.dress(right, style.with_unit("measured", stretch.unit), "", "all holdout blocks")
    style.legend_below(figure, left, 3)
    return figure
