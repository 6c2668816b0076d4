"""Regressed weights beside those they started from, their accuracy by fold, and the margins of held-out pairs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = np.ndarray

MARGIN_BINS = 40
HEADROOM = 1.25  # of the histogram, for its legend
SHOWN_SHARE = 0.98  # of the margins within the axis; the rest is counted in its ends
REGRESSED_LABEL = "tuned: regressed"


class WeightsPicture(NamedTuple):
    """What is drawn.

    Attributes:
        base: Name of the weights that the regression started from.
        metrics, base_metrics: Weight by metric, regressed and base.
        fold_accuracies: Name of weights -> accuracy of each fold, the regressed ones first.
        permuted: Mean accuracy with permuted labels.
        margins: Name of weights -> score margins of held-out pairs.
        margin: eps.
    """

    base: str
    metrics: Mapping[str, float]
    base_metrics: Mapping[str, float]
    fold_accuracies: Mapping[str, tuple[float, ...]]
    permuted: float
    margins: Mapping[str, Array]
    margin: float


def draw_weights(picture: WeightsPicture) -> Figure:
    """Three panels: weights, accuracy by fold, margins."""
    figure = style.new_figure(15.0, 3.4 + 0.36 * len(picture.metrics))
    weight_axes, fold_axes, margin_axes = figure.subplots(1, 3, width_ratios=(1.35, 1.0, 1.0))
    _draw_metrics(weight_axes, picture)
    _draw_folds(fold_axes, picture)
    _draw_margins(margin_axes, picture)
    pooled = next(iter(picture.margins.values()))
    share = 100.0 * float(np.mean(pooled > 0.0)) if len(pooled) else 0.0
    style.headline(
        figure, f"Regressed weights rank the human side first in {share:.0f} % of {len(pooled)} held-out pairs"
    )
    return figure


def _label(name: str, picture: WeightsPicture) -> str:
    """Label of a series, by which `style.looks` knows it."""
    if name == picture.base:
        return f"manual: {name}"
    return REGRESSED_LABEL if name == next(iter(picture.fold_accuracies)) else name


def _draw_metrics(axes: Axes, picture: WeightsPicture) -> None:
    rows = np.arange(len(picture.metrics))
    sides = ((REGRESSED_LABEL, picture.metrics, -0.2), (f"manual: {picture.base}", picture.base_metrics, 0.2))
    looks = style.looks([label for label, _, _ in sides])
    for label, values, offset in sides:
        hatch = "//" if looks[label] is style.MANUAL else ""
        axes.barh(
            rows + offset, list(values.values()), height=0.36, color=looks[label].colour, hatch=hatch,
            edgecolor="white", label=label,
        )  # fmt: skip
        for row, value in zip(rows + offset, values.values(), strict=True):
            axes.text(value, row, f" {style.number(value)}", va="center", fontsize=style.FONT_PT - 3, color=style.INK)
    axes.set_xlim(0.0, 1.15 * max(*picture.metrics.values(), *picture.base_metrics.values()))
    style.dress(axes, "weight", "")
    style.name_bars(axes, list(picture.metrics))
    axes.legend(fontsize=style.FONT_PT - 1, frameon=False, loc="lower right")


def _draw_folds(axes: Axes, picture: WeightsPicture) -> None:
    labels = [_label(name, picture) for name in picture.fold_accuracies]
    looks = style.looks(labels)
    for label, values in zip(labels, picture.fold_accuracies.values(), strict=True):
        look, folds = looks[label], np.arange(1, len(values) + 1)
        axes.plot(
            folds, 100.0 * np.asarray(values), color=look.colour, marker=look.marker, linestyle=look.dash, label=label
        )
    axes.axhline(100.0 * picture.permuted, color=style.FAINT, linestyle=":", linewidth=2.0, label="permuted labels")
    axes.set_ylim(0.0, 104.0)
    axes.set_xticks(range(1, max((len(values) for values in picture.fold_accuracies.values()), default=1) + 1))
    style.dress(axes, "fold (held-out groups)", "pairs ranked right (%)")
    axes.legend(fontsize=style.FONT_PT - 1, frameon=False, loc="lower left")


def _draw_margins(axes: Axes, picture: WeightsPicture) -> None:
    labels = [_label(name, picture) for name in picture.margins]
    looks = style.looks(labels)
    pooled = np.concatenate(list(picture.margins.values()))
    end = float(np.quantile(np.abs(pooled), SHOWN_SHARE)) if len(pooled) else 1.0
    edges = np.linspace(-end, end, MARGIN_BINS + 1)
    for label, values in zip(labels, picture.margins.values(), strict=True):
        look = looks[label]
        axes.hist(
            np.clip(values, -end, end), bins=list(edges), histtype="step", color=look.colour, linewidth=look.width,
            linestyle=look.dash if isinstance(look.dash, str) else "-", label=label,
        )  # fmt: skip
    axes.axvline(picture.margin, color=style.FAINT, linestyle="--", linewidth=1.6, label="margin")
    axes.axvline(0.0, color=style.INK, linewidth=1.0)
    style.dress(axes, "score of generated - score of human", "pairs")
    axes.locator_params(axis="x", nbins=5)
    axes.set_ylim(0.0, HEADROOM * axes.get_ylim()[1])
    axes.legend(fontsize=style.FONT_PT - 1, frameon=False, loc="upper left")
