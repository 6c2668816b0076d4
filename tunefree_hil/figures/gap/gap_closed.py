"""Figures of a repair: errors before, recalibrated, repaired and at their floor; traces; the residual's shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

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
WORDS = {"before": "as it was", "recalibrated": "recalibration only", "after": "repaired", "floor": "floor"}
BAR_IN, PANEL_IN = 0.2, 2.6
MOST_POINTS = 4000


class Bars(NamedTuple):
    """A signal's errors (RMS) by variant, in its unit; a variant that there is not is left out."""

    name: str
    unit: str
    errors: Mapping[str, float]


class Run(NamedTuple):
    """A signal over a stretch: measured, and simulated by variant."""

    name: str
    unit: str
    time_s: Numbers
    measured: Numbers
    simulated: Mapping[str, Numbers]


def write_shrink(path: Path, bars: Sequence[Bars], title: str) -> Path:
    """Write the figure of `draw_shrink` to `path` as PNG."""
    return style.save(draw_shrink(bars, title), path)


def write_runs(path: Path, runs: Sequence[Run], title: str) -> Path:
    """Write the figure of `draw_runs` to `path` as PNG."""
    return style.save(draw_runs(runs, title), path)


def write_signature(path: Path, stretch: Run, whole: Run, title: str) -> Path:
    """Write the figure of `draw_signature` to `path` as PNG."""
    return style.save(draw_signature(stretch, whole, title), path)


def draw_shrink(bars: Sequence[Bars], title: str) -> Figure:
    """A group a signal, in percent of the error of the model as it was; recalibration alone is always there."""
    variants = [name for name in LOOKS if any(name in one.errors for one in bars)]
    figure = style.new_figure(12.0, 2.0 + BAR_IN * max(len(bars), 2) * (len(variants) + 1.2))
    style.headline(figure, title)
    axes = figure.add_subplot()
    if not bars:
        style.say_missing(axes, "free runs")
        return figure
    width = 0.84 / len(variants)
    for row, variant in enumerate(variants):
        for y, one in enumerate(bars):
            if variant in one.errors:
                _bar(axes, y + (row - 0.5 * (len(variants) - 1)) * width, 0.92 * width, one, variant, y == 0)
    axes.set_yticks(range(len(bars)), [one.name for one in bars])
    axes.set_ylim(len(bars) - 0.45, -0.55)
    axes.set_xlim(0.0, 1.25 * max(100.0, *(_percent(one, name) for one in bars for name in one.errors)))
    style.dress(axes, "error on blocks that no fit has seen (RMS, % of the model as it was)", "")
    axes.grid(False, axis="y")
    style.legend_below(figure, axes, 4)
    return figure


def _percent(one: Bars, variant: str) -> float:
    whole = one.errors["before"]
    return 100.0 * one.errors[variant] / whole if whole > 0.0 else 0.0


def _bar(axes: Axes, at: float, width: float, one: Bars, variant: str, named: bool) -> None:
    """A bar with its own number and unit behind it."""
    look, length = LOOKS[variant], _percent(one, variant)
    hatch = "//" if variant == "floor" else ""
    label = WORDS[variant] if named else "_"
    axes.barh(at, length, height=width, color=look.colour, edgecolor="white", hatch=hatch, label=label)
    unit = "" if one.unit == "1" else f" {one.unit}"
    axes.text(length, at, f" {style.number(one.errors[variant])}{unit}", va="center", fontsize=style.FONT_PT - 4)


def draw_runs(runs: Sequence[Run], title: str) -> Figure:
    """A panel a signal: measured and simulated, on recorded commands alone."""
    figure = style.new_figure(13.0, 1.6 + PANEL_IN * max(len(runs), 1))
    style.headline(figure, title)
    if not runs:
        style.say_missing(figure.add_subplot(), "a block to prove")
        return figure
    panels = figure.subplots(len(runs), 1, sharex=True, squeeze=False)[:, 0]
    for axes, run in zip(panels, runs, strict=True):
        axes.plot(run.time_s, run.measured, color=style.INK, linewidth=3.2, alpha=0.35, label="measured")
        for variant, values in run.simulated.items():
            style.line(axes, run.time_s, values, LOOKS[variant]._replace(width=1.8), WORDS[variant])
        last = run is runs[-1]
        style.dress(axes, "time since the block began (s)" if last else "", _with_unit(run))
    style.legend_below(figure, panels[0], 4)
    return figure


def draw_signature(stretch: Run, whole: Run, title: str) -> Figure:
    """What is missed of a signal with and without the effect: over time in one block, and by the signal in all."""
    figure = style.new_figure(14.0, 5.2)
    style.headline(figure, title)
    left, right = figure.subplots(1, 2, width_ratios=[1.5, 1.0])
    for variant, values in stretch.simulated.items():
        look = LOOKS[variant]._replace(width=1.8)
        style.line(left, stretch.time_s, values - stretch.measured, look, WORDS[variant])
    thin = slice(None, None, max(1, len(whole.measured) // MOST_POINTS))
    for variant, values in whole.simulated.items():
        missed = (values - whole.measured)[thin]
        right.plot(
            whole.measured[thin], missed, linestyle="", marker=".", markersize=3, color=LOOKS[variant].colour,
            alpha=0.5,
        )  # fmt: skip
    unit = "" if stretch.unit == "1" else f" ({stretch.unit})"
    style.dress(left, "time since the block began (s)", f"simulated - measured{unit}", stretch.name)
    style.dress(right, f"measured{unit}", "", "all blocks of the proof")
    style.legend_below(figure, left, 3)
    return figure


def _with_unit(run: Run) -> str:
    return run.name if run.unit == "1" else f"{run.name} ({run.unit})"
