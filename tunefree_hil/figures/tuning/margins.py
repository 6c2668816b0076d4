"""Margins of the winner and the manual vectors: extra delay, steer gain, and failures of varied cars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = "Oranges"
DARK = 0.55  # share of failures above which the text is white
BAR = 0.62
BEYOND = " ▸"  # on a bar that ends at the limit of the search

Rows = Mapping[str, Mapping[str, Any]]  # vector -> its margins, as verify.json has them


def draw_margins(margins: Mapping[str, Any], tuned: str) -> Figure:
    """Draw delay margins, gain margins, and failures of varied cars.

    Args:
        margins: "margins" of verify.json (docs/reference/margins.md), with drives.
        tuned: Name of the winner, which is drawn on top.
    """
    vectors: Rows = margins["vectors"]
    names = [tuned, *(name for name in vectors if name != tuned)]
    height = 0.5 * len(names)
    figure = style.new_figure(15.0, 5.4 + 2.0 * height)
    grid = figure.add_gridspec(2, 2, height_ratios=(height + 1.0, height + 0.4))
    delays, gains = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    _draw_delays(delays, vectors, names, tuned)
    _draw_gains(gains, vectors, names, tuned)
    gains.tick_params(axis="y", labelleft=False)
    _draw_strip(figure.add_subplot(grid[1, :]), vectors, names)
    style.headline(figure, _sentence(margins, tuned))
    return figure


def _draw_delays(axes: Axes, vectors: Rows, names: Sequence[str], tuned: str) -> None:
    for row, name in enumerate(names):
        margin = vectors[name]["delay"]
        value_ms = 1e3 * margin["value"]
        axes.barh(row, value_ms, height=BAR, **_look(name, tuned))
        where = BEYOND if margin["at_least"] else f"  {margin['scenario']}: {margin['what']}"
        axes.text(value_ms, row, f" {value_ms:.0f} ms{where}", va="center", fontsize=style.FONT_PT - 2.0)
    longest = max(1e3 * vectors[name]["delay"]["value"] for name in names)
    axes.set_xlim(0.0, 1.8 * max(longest, 10.0))  # room for the words
    style.dress(axes, "extra steer dead time until the first re-plan, ms", "", "Delay margin")
    style.name_bars(axes, names)


def _draw_gains(axes: Axes, vectors: Rows, names: Sequence[str], tuned: str) -> None:
    for row, name in enumerate(names):
        low, high = vectors[name]["gain_down"], vectors[name]["gain_up"]
        axes.barh(row, high["value"] - low["value"], left=low["value"], height=BAR, **_look(name, tuned))
        before = "◂ " if low["at_least"] else ""
        size = style.FONT_PT - 2.0
        axes.text(low["value"], row, f"{before}{low['value']:.2f} ", va="center", ha="right", fontsize=size)
        after = BEYOND if high["at_least"] else ""
        axes.text(high["value"], row, f" {high['value']:.2f}{after}", va="center", fontsize=size)
    axes.axvline(1.0, color=style.INK, linewidth=1.4)
    axes.set_xlim(0.0, 1.15 * max(vectors[name]["gain_up"]["value"] for name in names))
    style.dress(axes, "factor on the steering at which the first re-plan comes", "", "Steer gain margin")
    style.name_bars(axes, names)


def _draw_strip(axes: Axes, vectors: Rows, names: Sequence[str]) -> None:
    """Failed scenarios by vector and varied car: factors within +/-20 % left of the line, larger ones right of it."""
    points = {name: sorted(vectors[name]["points"], key=lambda point: not point["inside"]) for name in names}
    first = points[names[0]]
    shares = np.array([[point["failed"] / max(point["drives"], 1) for point in points[name]] for name in names])
    axes.imshow(shares.reshape(len(names), len(first)), cmap=COLOURS, vmin=0.0, vmax=1.0, aspect="auto")
    for row, name in enumerate(names):
        for column, point in enumerate(points[name]):
            ink = "white" if point["failed"] / max(point["drives"], 1) > DARK else style.INK
            text = str(point["failed"]) if point["failed"] else "·"
            axes.text(column, row, text, ha="center", va="center", fontsize=style.FONT_PT - 1.0, color=ink)
    inside = sum(point["inside"] for point in first)
    axes.axvline(inside - 0.5, color=style.INK, linewidth=2.4)
    words = [_short(point) for point in first]
    axes.set_xticks(range(len(first)), words, rotation=42, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(names)), list(names), fontsize=style.FONT_PT - 1.0)
    axes.tick_params(axis="x", length=0, labelsize=style.FONT_PT - 2.0)
    drives = max((point["drives"] for point in first), default=0)
    title = f"Failed drives of {drives} with a varied car: within ±20 % left of the line, beyond right of it"
    axes.set_title(title, fontsize=style.FONT_PT, color=style.INK, loc="left")


def _short(point: Mapping[str, Any]) -> str:
    """How a car is varied; where all is varied, in three numbers."""
    if point["group"] != "together":
        return point["what"]
    factors = point["factors"]
    numbers = [f"{100.0 * (factors[name] - 1.0):+.0f}" for name in ("mass", "lag", "friction")]
    return f"mass, times, friction {' '.join(numbers)} %"


def _look(name: str, tuned: str) -> dict[str, Any]:
    look = style.TUNED if name == tuned else style.MANUAL
    return {"color": look.colour, "hatch": "" if name == tuned else "//", "edgecolor": "white"}


def _sentence(margins: Mapping[str, Any], tuned: str) -> str:
    """The delay margins, and the failures of the winner within +/-20 %."""
    mine, against = margins["vectors"][tuned], margins["against"]
    words = f"Delay margin of {tuned}: {1e3 * mine['delay']['value']:.0f} ms"
    if against is not None:
        words += f", of {against}: {1e3 * margins['vectors'][against]['delay']['value']:.0f} ms"
    inside = mine["inside"]
    return f"{words}; {inside['failed']} of {inside['drives']} drives fail within ±20 %"
