"""A hidden effect from end to end: the gap before and after, and what tuning on either model is worth on a vehicle."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.figures import style
from tunefree_hil.figures.bars import FAILURE_SCORE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


STAGES = ("before", "recalibrated", "after", "floor")
LOOKS = {"before": style.MANUAL, "recalibrated": style.OTHERS[2], "after": style.TUNED, "floor": style.OTHERS[3]}
BELOW: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.45, -0.08)}
TUNED_LOOKS = (style.MANUAL, style.TUNED)


class Tuned(NamedTuple):
    """A winner on the vehicle: score, score by scenario, re-plans, drives not finished, the best manual set's score."""

    score: float
    by_scenario: Mapping[str, float]
    replans: int
    failed: int
    manual: float


def write_demonstration(
    path: Path, signals: Mapping[str, Mapping[str, float]], tuned: Mapping[str, Tuned], sentence: str
) -> Path:
    """Write the figure of `draw_demonstration` to `path` as PNG."""
    return style.save(draw_demonstration(signals, tuned, sentence), path)


def draw_demonstration(signals: Mapping[str, Mapping[str, float]], tuned: Mapping[str, Tuned], sentence: str) -> Figure:
    """Left the gap of every signal as a share of what it was; right the winners' scores on the vehicle, road by road.

    signals: as in gap.json (interfaces 9), at least one. tuned: by the model that was tuned on, the old one first.
    """
    roads = list(dict.fromkeys(road for one in tuned.values() for road in one.by_scenario))
    figure = style.new_figure(14.0, 2.6 + 0.5 * max(len(signals) * 1.4, len(roads) * 1.2))
    gap, drives = figure.subplots(1, 2)
    _gap(gap, signals)
    _drives(drives, tuned, roads)
    style.headline(figure, sentence)
    return figure


def _gap(axes: Axes, signals: Mapping[str, Mapping[str, float]]) -> None:
    names = [name for name, values in signals.items() if values["before"] > 0.0]
    width = 0.8 / len(STAGES)
    for row, stage in enumerate(STAGES):
        shares = [signals[name][stage] / signals[name]["before"] for name in names]
        at = [i + (row - 1.5) * width for i in range(len(names))]
        axes.barh(at, shares, height=0.9 * width, color=LOOKS[stage].colour, label=stage)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.45, -0.55)
    style.dress(axes, "RMS of free run on proof blocks, share of what it was", "", "simulation against log")
    axes.grid(False, axis="y")
    axes.legend(fontsize=style.FONT_PT - 1, frameon=False, ncols=len(STAGES), **BELOW)


def _drives(axes: Axes, tuned: Mapping[str, Tuned], roads: list[str]) -> None:
    width = 0.8 / max(len(tuned), 1)
    for row, ((name, one), look) in enumerate(zip(tuned.items(), TUNED_LOOKS, strict=False)):
        at = [i + (row - 0.5 * (len(tuned) - 1)) * width for i in range(len(roads))]
        ends = [one.by_scenario.get(road, float("nan")) for road in roads]
        replans = f"{one.replans} re-plans" + (f", {one.failed} not finished" if one.failed else "")
        label = f"tuned on the {name} model: {style.number(one.score)} ({replans})"
        axes.barh(at, ends, height=0.9 * width, color=look.colour, label=label)
    axes.set_yticks(range(len(roads)), roads)
    axes.set_ylim(len(roads) - 0.45, -0.55)
    axes.set_xscale("log")
    style.plain_numbers(axes.xaxis)
    style.dress(axes, f"score on the vehicle (lower is better; {FAILURE_SCORE:g}: failed)", "", "roads no search saw")
    axes.grid(False, axis="y")
    axes.legend(fontsize=style.FONT_PT - 1, frameon=False, **BELOW)
