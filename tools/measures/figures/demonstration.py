"""Figure of a demonstration: the gap of a hidden effect before and after repair, and scores of tuned controllers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.figures import style
from tunefree_hil.figures.bars import FAILURE_SCORE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


STAGES = ("before", "recalibrated", "after", "floor")
LOOKS = {"before": style.MANUAL, "recalibrated": style.OTHERS[2], "after": style.TUNED, "floor": style.OTHERS[3]}
LEGEND_BELOW: dict[str, Any] = {"loc": "upper right", "bbox_to_anchor": (1.0, -0.08)}
TUNED_LOOKS = (style.MANUAL, style.TUNED)


class ParameterSetResult(NamedTuple):
    """How one parameter set drives on the vehicle: score (overall, by scenario), re-plans, unfinished drives."""

    score: float
    by_scenario: Mapping[str, float]
    replans: int
    failed: int

    @property
    def is_without_failures(self) -> bool:
        """Whether every drive was finished without a re-plan."""
        return not self.replans and not self.failed


def draw_demonstration(
    signals: Mapping[str, Mapping[str, float]],
    tuned: Mapping[str, Sequence[ParameterSetResult]],
    manual: ParameterSetResult,
    sentence: str,
) -> Figure:
    """Draw the gap of every signal (left) and the winners' scores on the vehicle, road by road (right).

    Args:
        signals: `signals` of gap.json (docs/reference/files.md), at least one.
        tuned: The winner of every search, by the model that was tuned on, the old model first.
        manual: The best parameter set that was not found by a search, on the same roads.
        sentence: Title of the figure.
    """
    roads = list(manual.by_scenario)
    figure = style.new_figure(14.0, 2.6 + 0.5 * max(len(signals) * 1.4, len(roads) * 1.2))
    gap, drives = figure.subplots(1, 2)
    _draw_gap(gap, signals)
    _draw_scores(drives, tuned, manual, roads)
    style.headline(figure, sentence)
    return figure


def _draw_gap(axes: Axes, signals: Mapping[str, Mapping[str, float]]) -> None:
    names = [name for name, values in signals.items() if values["before"] > 0.0]
    width = 0.8 / len(STAGES)
    for row, stage in enumerate(STAGES):
        shares = [signals[name][stage] / signals[name]["before"] for name in names]
        positions = [i + (row - 1.5) * width for i in range(len(names))]
        axes.barh(positions, shares, height=0.9 * width, color=LOOKS[stage].colour, label=stage)
    style.dress(axes, "free-run RMS on holdout blocks, share of the error before", "", "simulation against log")
    style.name_bars(axes, names)
    axes.legend(fontsize=style.FONT_PT - 1, frameon=False, ncols=len(STAGES), **LEGEND_BELOW)


def _draw_scores(
    axes: Axes, tuned: Mapping[str, Sequence[ParameterSetResult]], manual: ParameterSetResult, roads: list[str]
) -> None:
    """Draw medians of the searches as discs and single searches as dots; no bars, as the axis is logarithmic."""
    width = 0.8 / max(len(tuned), 1)
    for index, ((name, results), look) in enumerate(zip(tuned.items(), TUNED_LOOKS, strict=False)):
        positions = [i + (index - 0.5 * (len(tuned) - 1)) * width for i in range(len(roads))]
        scores = [[one.by_scenario[road] for one in results] for road in roads]
        label = f"tuned on the {name} model: {_describe_results(results)}"
        axes.plot([median(each) for each in scores], positions, "o", ms=11, color=look.colour, label=label)
        if len(results) > 1:
            axes.hlines(positions, [min(each) for each in scores], [max(each) for each in scores], look.colour, lw=3.0)
            places = [place for place in positions for _ in results]
            axes.plot([score for each in scores for score in each], places, "o", ms=4, mfc="white", mec=style.INK)
    ends = [manual.by_scenario[road] for road in roads]
    line = {"color": style.INK, "marker": "|", "ms": 40, "mew": 2.5, "ls": "", "zorder": 3}
    axes.plot(ends, range(len(roads)), label=f"best manual set: {_describe_results([manual])}", **line)
    axes.set_xscale("log")
    style.plain_numbers(axes.xaxis)
    label = f"score on the vehicle (lower is better; {FAILURE_SCORE:g}: failed)"
    style.dress(axes, label, "", "roads not used by a search")
    style.name_bars(axes, roads)
    axes.legend(fontsize=style.FONT_PT - 1, frameon=False, markerscale=0.7, **LEGEND_BELOW)


def _describe_results(results: Sequence[ParameterSetResult]) -> str:
    """'0.39 (0.3 to 0.5), no failure in 4 of 5 searches'; for one set '1.46, 8 re-plans, 1 drive not finished'."""
    scores = [result.score for result in results]
    middle = style.number(median(scores))
    if len(results) > 1:
        count = sum(result.is_without_failures for result in results)
        ends = f"{style.number(min(scores))} to {style.number(max(scores))}"
        return f"{middle} ({ends}), no failure in {count} of {len(results)} searches"
    (result,) = results
    unfinished = f", {_count_noun(result.failed, 'drive')} not finished" if result.failed else ""
    return f"{middle}, {_count_noun(result.replans, 're-plan')}{unfinished}"


def _count_noun(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"
