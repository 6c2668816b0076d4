"""Figure of learned plants: free-run errors by plant kind."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import TYPE_CHECKING, Any

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HORIZONS = ("1", "3", "10", "30")
PANELS = (("level", "Level ground"), ("hills", "Hills"))
SEVENTH_LOOK = style.Look(style.FAINT, (0, (3, 1)), "X", 1.6)  # type: ignore[arg-type]


def kind_looks(kinds: list[str]) -> dict[str, style.Look]:
    """A look for each kind: fixed ones for hybrid and physics, the others in order."""
    fixed_looks = {"hybrid": style.TUNED, "physics": style.MANUAL}
    further_looks = cycle((*style.OTHERS, SEVENTH_LOOK))
    return {kind: fixed_looks[kind] if kind in fixed_looks else next(further_looks) for kind in kinds}


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
