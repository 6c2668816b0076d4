"""Figures of learned plants: free-run errors by plant kind, and the simulated heading of one drive."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Numbers = NDArray[np.float64]
HORIZONS = ("1", "3", "10", "30")
PANELS = (("level", "Level ground"), ("hills", "Hills"))
DEGREES = 180.0 / np.pi
SEVENTH_LOOK = style.Look(style.FAINT, (0, (3, 1)), "X", 1.6)  # type: ignore[arg-type]
HEADING_KINDS = ("hybrid", "lstm", "mlp", "rule_based")  # kinds of the paper's Fig. 3b, and the hybrid
MIN_SHOWN_DEG = 0.01  # smaller heading errors are drawn as this
HEADING_MARGIN = 0.35  # above and below the measured headings, as a share of their range


class HeadingRun(NamedTuple):
    """Headings of one free run in rad, measured and by plant kind, over the time since its start."""

    time_s: Numbers
    truth: Numbers
    kinds: Mapping[str, Numbers]
    title: str


def kind_looks(kinds: list[str]) -> dict[str, style.Look]:
    """A look for each kind: fixed ones for hybrid and physics, the others in order."""
    fixed_looks = {"hybrid": style.TUNED, "physics": style.MANUAL}
    further_looks = cycle((*style.OTHERS, SEVENTH_LOOK))
    return {kind: fixed_looks[kind] if kind in fixed_looks else next(further_looks) for kind in kinds}


def write_free_run(path: Path, tables: Mapping[str, Mapping[str, Any]]) -> Path:
    """Write the figure of `draw_free_run` to `path` as PNG."""
    return style.save(draw_free_run(tables), path)


def draw_free_run(tables: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw the mean position error by horizon with 95 % interval and 95th percentile, a panel for each ground.

    Args:
        tables: By plant kind, as made by learn/evaluation/free_run.py.
    """
    panels = [(key, title) for key, title in PANELS if any(table.get(key) for table in tables.values())]
    figure = style.new_figure(max(6.5 * len(panels) + 1.0, 11.0), 5.6)
    first: Axes | None = None
    for column, (key, title) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), column + 1)
        rows = {kind: table[key] for kind, table in tables.items() if table.get(key)}
        _draw_bars(axes, rows)
        starts = next(iter(rows.values()))
        drives = "1 drive" if starts["drives"] == 1 else f"{starts['drives']} drives"
        starts_text = f"{starts['starts']} starts in {drives}"
        style.dress(axes, "free run (s)", "position error (m)", f"{title}: {starts_text}")
        first = first or axes
    if first is not None:
        style.legend_below(figure, first, min(len(tables), 6))
    style.headline(figure, _free_run_title(tables))
    return figure


def _draw_bars(axes: Axes, rows: Mapping[str, Mapping[str, Any]]) -> None:
    shown = [one for one in HORIZONS if any(one in row for row in rows.values())]
    width = 0.84 / max(len(rows), 1)
    for i, (kind, look) in enumerate(kind_looks(list(rows)).items()):
        for place, horizon in enumerate(shown):
            if horizon not in rows[kind]:
                continue
            error = rows[kind][horizon]["position_m"]
            position = place + (i - 0.5 * (len(rows) - 1)) * width
            label = kind if place == 0 else "_"
            axes.bar(position, error["mean"], width=0.9 * width, color=look.colour, label=label, edgecolor="white")
            if error["low"] is not None:  # of one drive there is no interval
                axes.vlines(position, error["low"], error["high"], color=style.INK, linewidth=1.2)
            axes.plot(
                [position - 0.4 * width, position + 0.4 * width], [error["p95"]] * 2, color=look.colour, linewidth=2.0
            )
    axes.set_xticks(range(len(shown)), shown)
    axes.set_yscale("log")
    style.plain_numbers(axes.yaxis)


def _free_run_title(tables: Mapping[str, Mapping[str, Any]]) -> str:
    means = {
        kind: table["level"]["10"]["position_m"]["mean"]
        for kind, table in tables.items()
        if table.get("level") and "10" in table["level"]
    }
    if "hybrid" not in means or "physics" not in means:
        return "Position error in free run (bar: mean and 95 % interval; dash: 95th percentile)"
    less = 100.0 * (1.0 - means["hybrid"] / means["physics"])
    words = f"{less:.0f} % less" if less >= 0.0 else f"{-less:.0f} % more"
    return f"After 10 s the hybrid is {style.number(means['hybrid'])} m off, {words} than the fitted physics"


def write_headings(path: Path, heading: HeadingRun) -> Path:
    """Write the figure of `draw_headings` to `path` as PNG."""
    return style.save(draw_headings(heading), path)


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
