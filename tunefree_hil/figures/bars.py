"""The score of each scenario, manual against tuned."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FAILURE_SCORE = 10.0  # docs/reference/grading.md; bars of failures are cut to keep the others readable
HEIGHT_IN = 0.28  # of one bar


def write_bars(path: Path, scores: Mapping[str, Mapping[str, float]], failure: float = FAILURE_SCORE) -> Path:
    """Write the figure of `draw_bars` to `path` as PNG."""
    return style.save(draw_bars(scores, failure), path)


def draw_bars(scores: Mapping[str, Mapping[str, float]], failure: float = FAILURE_SCORE) -> Figure:
    """Bars by scenario; scores: by label ("manual ...", "tuned ...", other baselines), then by scenario.

    A scenario that a label lacks has no bar. Scores from `failure` on are failed drives: the bar is cut and labelled.
    """
    labels = list(scores)
    scenarios = list(dict.fromkeys(name for label in labels for name in scores[label]))
    figure = style.new_figure(11.0, 2.2 + HEIGHT_IN * len(scenarios) * (len(labels) + 0.8))
    axes = figure.add_subplot()
    end = _end([score for one in scores.values() for score in one.values()], failure)
    for row, (label, look) in enumerate(style.looks(labels).items()):
        _draw_series(axes, scores[label], scenarios, (row, len(labels)), look, label, end)
    axes.set_yticks(range(len(scenarios)), scenarios)
    axes.set_ylim(len(scenarios) - 0.45, -0.55)  # the first on top
    axes.set_xlim(0.0, 1.12 * end)
    style.dress(axes, "score (lower is better)", "")
    axes.tick_params(axis="y", labelsize=style.FONT_PT)
    axes.grid(False, axis="y")
    style.legend_below(figure, axes, 3)
    style.headline(figure, _sentence(scores))
    return figure


def _end(values: list[float], failure: float) -> float:
    """The longest bar: the worst drive that did not fail."""
    sound = [value for value in values if value < failure]
    return 1.02 * max(sound) if sound and max(sound) > 0.0 else failure


def _draw_series(
    axes: Axes,
    scores: Mapping[str, float],
    scenarios: list[str],
    place: tuple[int, int],
    look: style.Look,
    label: str,
    end: float,
) -> None:
    """The bars of one label; `place`: which of how many in each group."""
    width = 0.82 / place[1]
    positions = {name: i + (place[0] - 0.5 * (place[1] - 1)) * width for i, name in enumerate(scenarios)}
    shown = [name for name in scenarios if name in scores]
    axes.barh(
        [positions[name] for name in shown],
        [min(scores[name], end) for name in shown],
        height=0.9 * width,
        color=look.colour,
        hatch="//" if look is style.MANUAL else "",
        edgecolor="white",
        label=label,
    )
    for name in shown:
        text = f" {style.number(scores[name])}" + (" ▸ failed" if scores[name] > end else "")
        axes.text(
            min(scores[name], end), positions[name], text, va="center", fontsize=style.FONT_PT - 2.0, color=style.INK
        )


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
