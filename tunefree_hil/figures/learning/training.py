"""Figures of learned plants: free-run errors of kinds beside each other, and what each says of one drive's heading."""

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
SEVENTH = style.Look(style.FAINT, (0, (3, 1)), "X", 1.6)  # type: ignore[arg-type]
HEADED = ("hybrid", "lstm", "mlp", "rule_based")  # those of the paper's Fig. 3b, and the hybrid
LEAST_DEG = 0.01  # an error that the picture still shows
ROOM = 0.35  # above and below the measured headings, of their range: a net that spins leaves the picture


class Heading(NamedTuple):
    """Headings of one free run, rad: truth and by kind; time_s from its start. where: the drive, in words."""

    time_s: Numbers
    truth: Numbers
    kinds: Mapping[str, Numbers]
    where: str


def kind_looks(kinds: list[str]) -> dict[str, style.Look]:
    """A look for each kind: the hybrid's and the physics' are their own, the rest go in order."""
    own = {"hybrid": style.TUNED, "physics": style.MANUAL}
    others = cycle((*style.OTHERS, SEVENTH))
    return {kind: own[kind] if kind in own else next(others) for kind in kinds}


def write_free_run(path: Path, tables: Mapping[str, Mapping[str, Any]]) -> Path:
    """Write the figure of `draw_free_run` to `path` as PNG."""
    return style.save(draw_free_run(tables), path)


def draw_free_run(tables: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Mean position error by horizon (bars, 95 % interval; a dash at the 95th percentile), a panel for each ground.

    tables: by kind, as learn/evaluation/free_run.py gives them.
    """
    panels = [(key, title) for key, title in PANELS if any(table.get(key) for table in tables.values())]
    figure = style.new_figure(max(6.5 * len(panels) + 1.0, 11.0), 5.6)
    first: Axes | None = None
    for place, (key, title) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), place + 1)
        rows = {kind: table[key] for kind, table in tables.items() if table.get(key)}
        _bars(axes, rows)
        starts = next(iter(rows.values()))
        drives = "1 drive" if starts["drives"] == 1 else f"{starts['drives']} drives"
        many = f"{starts['starts']} starts in {drives}"
        style.dress(axes, "free run (s)", "position error (m)", f"{title}: {many}")
        first = first or axes
    if first is not None:
        style.legend_below(figure, first, min(len(tables), 6))
    style.headline(figure, _sentence(tables))
    return figure


def _bars(axes: Axes, rows: Mapping[str, Mapping[str, Any]]) -> None:
    shown = [one for one in HORIZONS if any(one in row for row in rows.values())]
    width = 0.84 / max(len(rows), 1)
    for i, (kind, look) in enumerate(kind_looks(list(rows)).items()):
        for place, horizon in enumerate(shown):
            if horizon not in rows[kind]:
                continue
            one = rows[kind][horizon]["position_m"]
            at = place + (i - 0.5 * (len(rows) - 1)) * width
            label = kind if place == 0 else "_"
            axes.bar(at, one["mean"], width=0.9 * width, color=look.colour, label=label, edgecolor="white")
            if one["low"] is not None:  # of one drive there is no interval
                axes.vlines(at, one["low"], one["high"], color=style.INK, linewidth=1.2)
            axes.plot([at - 0.4 * width, at + 0.4 * width], [one["p95"]] * 2, color=look.colour, linewidth=2.0)
    axes.set_xticks(range(len(shown)), shown)
    axes.set_yscale("log")
    style.plain_numbers(axes.yaxis)


def _sentence(tables: Mapping[str, Mapping[str, Any]]) -> str:
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


def write_headings(path: Path, heading: Heading) -> Path:
    """Write the figure of `draw_headings` to `path` as PNG."""
    return style.save(draw_headings(heading), path)


def draw_headings(heading: Heading) -> Figure:
    """The comparison of the paper's Fig. 3b: heading over time above, by how much each kind is off below (log)."""
    figure = style.new_figure(11.5, 8.0)
    above = figure.add_subplot(2, 1, 1)
    below = figure.add_subplot(2, 1, 2, sharex=above)
    truth = DEGREES * (heading.truth - heading.truth[0])
    style.line(above, heading.time_s, truth, style.REFERENCE._replace(width=3.0), "measured")
    shown = {kind: heading.kinds[kind] for kind in HEADED if kind in heading.kinds} or dict(heading.kinds)
    errors = {kind: DEGREES * np.abs(values - heading.truth) for kind, values in shown.items()}
    for kind, look in kind_looks(list(shown)).items():
        style.line(above, heading.time_s, DEGREES * (shown[kind] - heading.truth[0]), look, kind)
        style.line(below, heading.time_s, np.maximum(errors[kind], LEAST_DEG), look)
    low, high = float(truth.min()), float(truth.max())
    room = max(ROOM * (high - low), 1.0)
    above.set_ylim(low - room, high + room)
    below.set_yscale("log")
    below.set_ylim(bottom=LEAST_DEG)
    style.plain_numbers(below.yaxis)
    style.dress(above, "", "heading (deg)", heading.where)
    style.dress(below, "free run (s)", "off by (deg)")
    style.legend_below(figure, above, 6)
    style.headline(figure, _off(errors))
    return figure


def _off(errors: Mapping[str, Numbers]) -> str:
    """Mean error of each kind, the least first."""
    means = sorted((float(values.mean()), kind) for kind, values in errors.items())
    words = ", ".join(f"{kind} {style.number(mean)}" for mean, kind in means)
    return f"Mean heading error (deg): {words}"
