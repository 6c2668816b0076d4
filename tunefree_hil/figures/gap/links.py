"""Figures of a gap search: the misfit by region of driving, and the evidence for each candidate effect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW_IN = 0.36
MAX_CANDIDATES = 16
RATIO_RANGE = (0.05, 20.0)  # ratios of mean squares on the axis; values beyond are clipped


class RegionMisfit(NamedTuple):
    """Misfit in a region of driving: RMS there, and the ratio of its mean square to the rest's with 95 % interval."""

    label: str
    rms: float
    ratio: float
    low: float
    high: float
    stands_out: bool


class CandidateEvidence(NamedTuple):
    """A candidate: log evidence and held-out gain over recalibration alone (nats), and whether it is accepted."""

    name: str
    evidence: float
    held_out: float
    is_accepted: bool


def draw_regions(regions: Sequence[RegionMisfit], unit: str, title: str) -> Figure:
    """Draw how much larger (or smaller) the misfit is in each region than in the rest of the drive."""
    figure = style.new_figure(12.0, 1.9 + ROW_IN * max(len(regions), 2))
    style.headline(figure, title)
    axes = figure.add_subplot()
    if not regions:
        style.say_missing(axes, "regions")
        return figure
    for y, region in enumerate(regions):
        look = style.MANUAL if region.stands_out else style.OTHERS[3]
        low, high, ratio = np.clip([region.low, region.high, region.ratio], *RATIO_RANGE).tolist()
        axes.barh(y, ratio - 1.0, left=1.0, height=0.7, color=look.colour, label="_")
        axes.plot([low, high], [y, y], color=style.INK, linewidth=1.6)
        text = f"{style.number(region.rms)} {unit}"
        axes.text(1.02 * RATIO_RANGE[1], y, text, va="center", fontsize=style.FONT_PT - 2)
    axes.axvline(1.0, color=style.INK, linewidth=1.2)
    axes.set_xscale("log")
    axes.set_xlim(*RATIO_RANGE)
    style.plain_numbers(axes.xaxis)
    style.dress(axes, "mean square over that of the rest, 95 % interval (right: RMS)", "")
    style.name_bars(axes, [region.label for region in regions], 0.4)
    _draw_legend(figure, axes, (("stands out", style.MANUAL.colour), ("does not", style.OTHERS[3].colour)))
    return figure


def draw_evidence(candidates: Sequence[CandidateEvidence], min_nats: float, title: str) -> Figure:
    """Draw the evidence of the best candidates with the acceptance threshold, and the gain on held-out blocks."""
    shown = sorted(candidates, key=lambda step: -step.evidence)[:MAX_CANDIDATES]
    figure = style.new_figure(12.0, 2.0 + ROW_IN * max(len(shown), 2))
    style.headline(figure, title)
    axes = figure.add_subplot()
    if not shown:
        style.say_missing(axes, "candidates")
        return figure
    for y, candidate in enumerate(shown):
        look = style.TUNED if candidate.is_accepted else style.OTHERS[3]
        axes.barh(y, candidate.evidence, height=0.7, color=look.colour, label="_")
        axes.plot(candidate.held_out, y, marker="D", color=style.INK, markersize=7, linestyle="", label="_")
    axes.axvline(min_nats, color=style.MANUAL.colour, linestyle="--", linewidth=2.0)
    axes.set_xscale("symlog", linthresh=10.0)
    style.dress(axes, "nats over recalibration alone (straight to 10, then logarithmic)", "")
    style.name_bars(axes, [candidate.name for candidate in shown], 0.4)
    axes.plot([], [], marker="D", color=style.INK, linestyle="", label="gain on held-out blocks")
    axes.plot([], [], color=style.MANUAL.colour, linestyle="--", linewidth=2.0, label=f"needed: {min_nats:g}")
    _draw_legend(figure, axes, (("passes every criterion", style.TUNED.colour), ("does not", style.OTHERS[3].colour)))
    return figure


def _draw_legend(figure: Figure, axes: Axes, patches: Sequence[tuple[str, str]]) -> None:
    for label, colour in patches:
        axes.plot([], [], marker="s", markersize=11, color=colour, linestyle="", label=label)
    style.legend_below(figure, axes, 4)
