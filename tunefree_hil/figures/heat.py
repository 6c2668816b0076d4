"""Composition of a score difference: a table of scenarios by terms, coloured by sign; its cells add up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = "RdBu_r"  # blue: the winner is better; red: the other one; suitable for colour blindness
DARK = 0.62  # of the colour scale, above which the ink is white
LEAST_IN = 9.0
LEAST_PT = 10.5
PT_PER_IN = 0.76  # of the figure's width: a wide table is shown smaller, so its text is larger
WITHIN = 0.95  # share of the cells within the colour scale
TOTAL = "sum"


def draw_heat(terms: Mapping[str, Mapping[str, float]], title: str) -> Figure:
    """terms: by scenario, then by term, winner - other; in thousandths of the score.

    Terms with only cells that round to 0 are left out, and counted.
    """
    scenarios = list(terms)
    names = [name for name in terms[scenarios[0]] if any(_is_seen(terms[one][name]) for one in scenarios)]
    hidden = sum(any(row[name] != 0.0 for row in terms.values()) for name in terms[scenarios[0]] if name not in names)
    cells = np.array([[terms[one][name] for name in names] for one in scenarios]).reshape(len(scenarios), len(names))
    sums = np.array([sum(terms[one].values()) for one in scenarios])
    table = _with_sums(1e3 * cells, 1e3 * sums)
    width_in = max(LEAST_IN, 3.8 + 0.72 * (len(names) + 1))
    size = max(LEAST_PT, PT_PER_IN * width_in)
    figure = style.new_figure(width_in, 3.6 + 0.5 * (len(scenarios) + 1))
    axes = figure.add_subplot()
    limit = _limit(1e3 * np.abs(cells))
    shown = np.clip(table, -limit, limit)
    axes.imshow(shown, cmap=COLOURS, vmin=-limit, vmax=limit, aspect="auto")
    for row, column in np.ndindex(*table.shape):
        ink = "white" if abs(shown[row, column]) > DARK * limit else style.INK
        outer = row == len(scenarios) or column == len(names)
        axes.text(
            column, row, _cell(float(table[row, column])), ha="center", va="center", fontsize=size, color=ink,
            fontweight="bold" if outer else "normal",
        )  # fmt: skip
    _labels(axes, [*names, TOTAL], [*scenarios, TOTAL], size)
    axes.axhline(len(scenarios) - 0.5, color=style.INK, linewidth=1.6)
    axes.axvline(len(names) - 0.5, color=style.INK, linewidth=1.6)
    words = "thousandths of the score, winner - manual; negative (blue): winner better"
    if hidden:
        words += f"\n{hidden} terms differ by less than 0.05 everywhere and are in the sums only"
    axes.set_xlabel(words if names else "no difference in any term", fontsize=size)
    style.headline(figure, title)
    return figure


def _limit(sizes: np.ndarray) -> float:
    """End of the colour scale: few cells exceed it, as one large cell would make all others white."""
    known = sizes[sizes > 0.0]
    return float(np.quantile(known, WITHIN)) if known.size else 1.0


def _is_seen(term: float) -> bool:
    return _cell(1e3 * term) != "0"


def _with_sums(cells: np.ndarray, sums: np.ndarray) -> np.ndarray:
    """A last column with the rows' sums (of all terms, shown or not), and a last row with the columns'."""
    wide = np.hstack([cells, sums[:, None]])
    return np.vstack([wide, wide.sum(axis=0, keepdims=True)])


def _cell(value: float) -> str:
    """Short text for a cell; 0 where it rounds to 0."""
    if abs(value) < 0.05:
        return "0"
    return f"{value:+.0f}" if abs(value) >= 99.5 else f"{value:+.1f}"


def _labels(axes: Axes, columns: Sequence[str], rows: Sequence[str], size: float) -> None:
    axes.set_xticks(range(len(columns)), columns, rotation=40, ha="left", rotation_mode="anchor", fontsize=size)
    axes.xaxis.tick_top()
    axes.set_yticks(range(len(rows)), rows, fontsize=size)
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
