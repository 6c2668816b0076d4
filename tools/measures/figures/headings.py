"""Figure of the simulated heading of one drive by plant kind (paper, Fig. 3b)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style
from tunefree_hil.figures.learning.training import kind_looks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Numbers = NDArray[np.float64]
DEGREES = 180.0 / np.pi
HEADING_KINDS = ("hybrid", "lstm", "mlp", "rule_based")  # kinds of the paper's Fig. 3b, and the hybrid
MIN_SHOWN_DEG = 0.01  # smaller heading errors are drawn as this
HEADING_MARGIN = 0.35  # above and below the measured headings, as a share of their range


class HeadingRun(NamedTuple):
    """Headings of one free run in rad, measured and by plant kind, over the time since its start."""

    time_s: Numbers
    truth: Numbers
    kinds: Mapping[str, Numbers]
    title: str


def draw_headings(heading: HeadingRun) -> Figure:
    """Draw the comparison of the paper's Fig. 3b: heading over time, and below the error of each kind (log)."""
    figure = style.new_figure(11.5, 8.0)
    above = figure.add_subplot(2, 1, 1)
    below = figure.add_subplot(2, 1, 2, sharex=above)
    truth = DEGREES * (heading.truth - heading.truth[0])
    style.line(above, heading.time_s, truth, style.REFERENCE._replace(width=3.0), "measured")
    shown = {kind: heading.kinds[kind] for kind in HEADING_KINDS if kind in heading.kinds} or dict(heading.kinds)
    errors = {kind: DEGREES * np.abs(values - heading.truth) for kind, values in shown.items()}
    for kind, look in kind_looks(list(shown)).items():
        style.line(above, heading.time_s, DEGREES * (shown[kind] - heading.truth[0]), look, kind)
        style.line(below, heading.time_s, np.maximum(errors[kind], MIN_SHOWN_DEG), look)
    low, high = float(truth.min()), float(truth.max())
    room = max(HEADING_MARGIN * (high - low), 1.0)
    above.set_ylim(low - room, high + room)
    below.set_yscale("log")
    below.set_ylim(bottom=MIN_SHOWN_DEG)
    style.plain_numbers(below.yaxis)
    style.dress(above, "", "heading (deg)", heading.title)
    style.dress(below, "free run (s)", "error (deg)")
    style.legend_below(figure, above, 6)
    style.headline(figure, _heading_title(errors))
    return figure


def _heading_title(errors: Mapping[str, Numbers]) -> str:
    """Title with the mean error of each kind, the smallest first."""
    means = sorted((float(values.mean()), kind) for kind, values in errors.items())
    words = ", ".join(f"{kind} {style.number(mean)}" for mean, kind in means)
    return f"Mean heading error (deg): {words}"
