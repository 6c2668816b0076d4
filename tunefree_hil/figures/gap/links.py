"""Figures of a search for what a model lacks: where it is missed, and the evidence for each suspect."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW_IN = 0.36
MOST_STEPS = 16
RATIOS = (0.05, 20.0)  # of mean squares, that are drawn: beyond them it is cut


class Where(NamedTuple):
    """A region of driving: its words, RMS of what is missed there, the ratio of its mean square to the rest's with a
    95 % interval, and whether it stands out.
    """

    words: str
    rms: float
    ratio: float
    low: float
    high: float
    stands_out: bool


class Step(NamedTuple):
    """A suspect: log evidence and held-out gain over recalibration alone (nats), and whether it counts as a name."""

    name: str
    evidence: float
    held_out: float
    counts: bool


def write_where(path: Path, regions: Sequence[Where], unit: str, title: str) -> Path:
    """Write the figure of `draw_where` to `path` as PNG."""
    return style.save(draw_where(regions, unit, title), path)


def write_ladder(path: Path, steps: Sequence[Step], least_nats: float, title: str) -> Path:
    """Write the figure of `draw_ladder` to `path` as PNG."""
    return style.save(draw_ladder(steps, least_nats, title), path)


def draw_where(regions: Sequence[Where], unit: str, title: str) -> Figure:
    """How much more (or less) is missed in each region than in the rest of the drive."""
    figure = style.new_figure(12.0, 1.9 + ROW_IN * max(len(regions), 2))
    style.headline(figure, title)
    axes = figure.add_subplot()
    if not regions:
        style.say_missing(axes, "regions")
        return figure
    for y, one in enumerate(regions):
        look = style.MANUAL if one.stands_out else style.OTHERS[3]
        low, high, ratio = (min(max(value, RATIOS[0]), RATIOS[1]) for value in (one.low, one.high, one.ratio))
        axes.barh(y, ratio - 1.0, left=1.0, height=0.7, color=look.colour, label="_")
        axes.plot([low, high], [y, y], color=style.INK, linewidth=1.6)
        axes.text(1.02 * RATIOS[1], y, f"{style.number(one.rms)} {unit}", va="center", fontsize=style.FONT_PT - 2)
    axes.axvline(1.0, color=style.INK, linewidth=1.2)
    axes.set_xscale("log")
    axes.set_xlim(*RATIOS)
    style.plain_numbers(axes.xaxis)
    axes.set_yticks(range(len(regions)), [one.words for one in regions])
    axes.set_ylim(len(regions) - 0.4, -0.6)
    style.dress(axes, "mean square there over the rest's, 95 % interval (right: RMS there)", "")
    axes.grid(False, axis="y")
    _legend(figure, axes, (("stands out", style.MANUAL.colour), ("does not", style.OTHERS[3].colour)))
    return figure


def draw_ladder(steps: Sequence[Step], least_nats: float, title: str) -> Figure:
    """Evidence of the best suspects and the line that a name must pass, with the gain on blocks not fitted on."""
    some = sorted(steps, key=lambda one: -one.evidence)[:MOST_STEPS]
    figure = style.new_figure(12.0, 2.0 + ROW_IN * max(len(some), 2))
    style.headline(figure, title)
    axes = figure.add_subplot()
    if not some:
        style.say_missing(axes, "suspects")
        return figure
    for y, one in enumerate(some):
        look = style.TUNED if one.counts else style.OTHERS[3]
        axes.barh(y, one.evidence, height=0.7, color=look.colour, label="_")
        axes.plot(one.held_out, y, marker="D", color=style.INK, markersize=7, linestyle="", label="_")
    axes.axvline(least_nats, color=style.MANUAL.colour, linestyle="--", linewidth=2.0)
    axes.set_xscale("symlog", linthresh=10.0)
    axes.set_yticks(range(len(some)), [one.name for one in some])
    axes.set_ylim(len(some) - 0.4, -0.6)
    style.dress(axes, "nats over recalibration alone (straight to 10, then logarithmic)", "")
    axes.grid(False, axis="y")
    axes.plot([], [], marker="D", color=style.INK, linestyle="", label="gain on blocks that it was not fitted on")
    axes.plot([], [], color=style.MANUAL.colour, linestyle="--", linewidth=2.0, label=f"a name needs {least_nats:g}")
    _legend(figure, axes, (("passes every test", style.TUNED.colour), ("does not", style.OTHERS[3].colour)))
    return figure


def _legend(figure: Figure, axes: Axes, patches: Sequence[tuple[str, str]]) -> None:
    for label, colour in patches:
        axes.plot([], [], marker="s", markersize=11, color=colour, linestyle="", label=label)
    style.legend_below(figure, axes, 4)
