"""A hidden effect from end to end: the gap before and after, and what tuning on either model is worth on a vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.figures import style
from tunefree_hil.figures.bars import FAILURE_SCORE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


STAGES = ("before", "recalibrated", "after", "floor")
LOOKS = {"before": style.MANUAL, "recalibrated": style.OTHERS[2], "after": style.TUNED, "floor": style.OTHERS[3]}
BELOW: dict[str, Any] = {"loc": "upper right", "bbox_to_anchor": (1.0, -0.08)}
TUNED_LOOKS = (style.MANUAL, style.TUNED)


class Driven(NamedTuple):
    """A set of numbers on the vehicle: score, score by scenario, re-plans, drives not finished."""

    score: float
    by_scenario: Mapping[str, float]
    replans: int
    failed: int

    @property
    def holds(self) -> bool:
        """Whether it finishes every road and never loses its path so far that it must be planned anew."""
        return not self.replans and not self.failed


def write_demonstration(
    path: Path,
    signals: Mapping[str, Mapping[str, float]],
    tuned: Mapping[str, Sequence[Driven]],
    manual: Driven,
    sentence: str,
) -> Path:
    """Write the figure of `draw_demonstration` to `path` as PNG."""
    return style.save(draw_demonstration(signals, tuned, manual, sentence), path)


def draw_demonstration(
    signals: Mapping[str, Mapping[str, float]], tuned: Mapping[str, Sequence[Driven]], manual: Driven, sentence: str
) -> Figure:
    """Left the gap of every signal as a share of what it was; right the winners' scores on the vehicle, road by road.

    signals: as in gap.json (interfaces 9), at least one. tuned: the winner of every search, by the model that was tuned
    on, the old one first. manual: the best set that no search found, on the same roads.
    """
    roads = list(manual.by_scenario)
    figure = style.new_figure(14.0, 2.6 + 0.5 * max(len(signals) * 1.4, len(roads) * 1.2))
    gap, drives = figure.subplots(1, 2)
    _gap(gap, signals)
    _drives(drives, tuned, manual, roads)
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


def _drives(axes: Axes, tuned: Mapping[str, Sequence[Driven]], manual: Driven, roads: list[str]) -> None:
    """Discs: medians of the searches; dots on a line from best to worst: each of them. Logarithmic, so no bars."""
    width = 0.8 / max(len(tuned), 1)
    for row, ((name, some), look) in enumerate(zip(tuned.items(), TUNED_LOOKS, strict=False)):
        at = [i + (row - 0.5 * (len(tuned) - 1)) * width for i in range(len(roads))]
        scores = [[one.by_scenario[road] for one in some] for road in roads]
        label = f"tuned on the {name} model: {_words(some)}"
        axes.plot([median(each) for each in scores], at, "o", ms=11, color=look.colour, label=label)
        if len(some) > 1:
            axes.hlines(at, [min(each) for each in scores], [max(each) for each in scores], look.colour, lw=3.0)
            places = [place for place in at for _ in some]
            axes.plot([score for each in scores for score in each], places, "o", ms=4, mfc="white", mec=style.INK)
    ends = [manual.by_scenario[road] for road in roads]
    line = {"color": style.INK, "marker": "|", "ms": 40, "mew": 2.5, "ls": "", "zorder": 3}
    axes.plot(ends, range(len(roads)), label=f"best set that no search found: {_words([manual])}", **line)
    axes.set_yticks(range(len(roads)), roads)
    axes.set_ylim(len(roads) - 0.45, -0.55)
    axes.set_xscale("log")
    style.plain_numbers(axes.xaxis)
    style.dress(axes, f"score on the vehicle (lower is better; {FAILURE_SCORE:g}: failed)", "", "roads no search saw")
    axes.grid(False, axis="y")
    axes.legend(fontsize=style.FONT_PT - 1, frameon=False, markerscale=0.7, **BELOW)


def _words(some: Sequence[Driven]) -> str:
    """'0.39 (0.3 to 0.5), holds in 4 of 5 searches', of one '1.46, 8 re-plans, 1 drive not finished'."""
    middle = style.number(median(one.score for one in some))
    if len(some) > 1:
        low, high = (style.number(end) for end in (min(one.score for one in some), max(one.score for one in some)))
        return f"{middle} ({low} to {high}), holds in {sum(one.holds for one in some)} of {len(some)} searches"
    (one,) = some
    lost = f", {_counted(one.failed, 'drive')} not finished" if one.failed else ""
    return f"{middle}, {_counted(one.replans, 're-plan')}{lost}"


def _counted(n: int, what: str) -> str:
    return f"{n} {what}" if n == 1 else f"{n} {what}s"
