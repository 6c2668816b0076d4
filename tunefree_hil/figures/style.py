"""Style of all figures. matplotlib is imported inside functions only, which saves start-up time.

Figures are objects on an Agg canvas; pyplot and its global state are not used. Sizes are chosen so that a picture is
readable at half its pixels. The colours are those of Okabe and Ito, suitable for colour blindness; marker or dash
differ too.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

FONT_PT, TITLE_PT, DPI = 13, 15, 120
INK, FAINT = "#222222", "#9a9a9a"
SCORE_COLOURS = "viridis_r"  # dark is high: bad


class Look(NamedTuple):
    """Colour, dash, marker and width of one series."""

    colour: str
    dash: str
    marker: str
    width: float


REFERENCE = Look(INK, ":", "", 2.0)
MANUAL = Look("#d55e00", "--", "D", 2.0)
TUNED = Look("#0072b2", "-", "o", 2.4)
OTHERS = (
    Look("#009e73", "-.", "s", 1.6),
    Look("#cc79a7", (0, (5, 1, 1, 1, 1, 1)), "^", 1.6),  # type: ignore[arg-type]
    Look("#e69f00", (0, (1, 1)), "v", 1.6),  # type: ignore[arg-type]
    Look("#56b4e9", (0, (6, 2)), "P", 1.6),  # type: ignore[arg-type]
)


def looks(labels: Sequence[str]) -> dict[str, Look]:
    """A look for each label: "manual" and "tuned" have their own wherever they start a label, the rest go in order."""
    looks: dict[str, Look] = {}
    others = 0
    for label in labels:
        if label.startswith("tuned"):
            looks[label] = TUNED
        elif label.startswith("manual"):
            looks[label] = MANUAL
        else:
            looks[label] = OTHERS[others % len(OTHERS)]
            others += 1
    return looks


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure on a canvas of its own, which lays itself out."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def headline(figure: Figure, text: str) -> None:
    """The figure's title: a sentence with its message."""
    figure.suptitle(text, fontsize=TITLE_PT, color=INK, fontweight="bold")


def dress(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Labels with units, readable ticks, a faint grid."""
    axes.set_xlabel(x, fontsize=FONT_PT, color=INK)
    axes.set_ylabel(y, fontsize=FONT_PT, color=INK)
    if title:
        axes.set_title(title, fontsize=FONT_PT, color=INK, loc="left")
    axes.tick_params(labelsize=FONT_PT - 1.5, colors=INK)
    axes.grid(True, color="#dddddd", linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def line(axes: Axes, x: Any, y: Any, look: Look, label: str = "") -> None:
    """One series as a line."""
    axes.plot(x, y, color=look.colour, linestyle=look.dash, linewidth=look.width, label=label or "_")


def name_bars(axes: Axes, names: Sequence[str], edge: float = 0.45) -> None:
    """Name the rows of a panel of horizontal bars, the first on top; after `dress`, whose lines between them go."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - edge, edge - 1.0)
    axes.grid(False, axis="y")


def with_unit(name: str, unit: str) -> str:
    """'speed (m/s)'; a dimensionless quantity (unit "1" or "") has its name only."""
    return f"{name} ({unit})" if unit not in ("", "1") else name


def legend_below(figure: Figure, axes: Axes, columns: int) -> None:
    """The legend of `axes` under everything, so that it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=FONT_PT - 0.5, frameon=False)


def number(value: float) -> str:
    """Three figures, without an exponent where it is not needed."""
    if 999.5 <= abs(value) < 1e5:
        return f"{value:.0f}"
    if 1e-3 <= abs(value) < 1e3 or value == 0.0 or not math.isfinite(value):
        return f"{value:.3g}"
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def plain_numbers(axis: Axis, narrow: bool = False) -> None:
    """Ticks of a log axis as plain numbers at 1, 2, 5, or where the range is `narrow` at every digit."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=tuple(range(1, 10)) if narrow else (1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: number(value)))
    axis.set_minor_formatter(NullFormatter())


def say_missing(axes: Axes, label: str) -> None:
    """Write into an empty panel why it is empty."""
    axes.text(0.5, 0.5, f"{label}: not recorded", transform=axes.transAxes, ha="center", va="center", fontsize=FONT_PT)


def save(figure: Figure, path: Path) -> Path:
    """Write `figure` to `path` as PNG: atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    figure.savefig(part, format="png", dpi=DPI)
    os.replace(part, path)
    return path
