"""The score of each scenario, manual against tuned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FAILURE_SCORE = 10.0  # docs/reference/grading.md; bars of failures are cut to keep the others readable
HEIGHT_IN = 0.28  # of one bar


def draw_bars(scores: Mapping[str, Mapping[str, float]]) -> Figure:
    """Bars by scenario; scores: by label ("manual ...", "tuned ...", other baselines), then by scenario.

    A scenario that a label lacks has no bar. Scores from FAILURE_SCORE on are failed drives: the bar is cut and
    labelled.
    """
    labels = list(scores)
    scenarios = list(dict.fromkeys(name for label in labels for name in scores[label]))
    figure = style.new_figure(11.0, 2.2 + HEIGHT_IN * len(scenarios) * (len(labels) + 0.8))
    axes = figure.add_subplot()
    end = _longest_bar([score for by_scenario in scores.values() for score in by_scenario.values()])
    width = 0.82 / len(labels)
    for row, label in enumerate(labels):
        offset = (row - 0.5 * (len(labels) - 1)) * width
        shown = {i + offset: scores[label][name] for i, name in enumerate(scenarios) if name in scores[label]}
        look = style.looks(labels)[label]
        hatch = "//" if look is style.MANUAL else ""
        lengths = [min(score, end) for score in shown.values()]
        bar_style: dict[str, Any] = {"color": look.colour, "hatch": hatch, "edgecolor": "white", "label": label}
        axes.barh(list(shown), lengths, height=0.9 * width, **bar_style)
        for (position, score), length in zip(shown.items(), lengths, strict=True):
            text = f" {style.number(score)}" + (" ▸ failed" if score > end else "")
            axes.text(length, position, text, va="center", fontsize=style.FONT_PT - 2.0, color=style.INK)
    axes.set_xlim(0.0, 1.12 * end)
    style.dress(axes, "score (lower is better)", "")
    style.name_bars(axes, scenarios)
    axes.tick_params(axis="y", labelsize=style.FONT_PT)
    style.legend_below(figure, axes, 3)
    style.headline(figure, _sentence(scores))
    return figure


def _longest_bar(scores: list[float]) -> float:
    """Length of the longest bar: the worst drive that did not fail."""
    sound = [score for score in scores if score < FAILURE_SCORE]
    return 1.02 * max(sound) if sound and max(sound) > 0.0 else FAILURE_SCORE


def _sentence(scores: Mapping[str, Mapping[str, float]]) -> str:
    """In how many scenarios the first tuned label beats the first manual one."""
    tuned = next((label for label in scores if label.startswith("tuned")), None)
    manual = next((label for label in scores if label.startswith("manual")), None)
    if tuned is None or manual is None:
        return "Score of each scenario"
    both = [name for name in scores[tuned] if name in scores[manual]]
    better = sum(scores[tuned][name] < scores[manual][name] for name in both)
    ratio = float(np.median([scores[tuned][name] / max(scores[manual][name], 1e-9) for name in both])) if both else 1.0
    return f"Tuned is better in {better} of {len(both)} scenarios (median ratio {ratio:.2f})"
