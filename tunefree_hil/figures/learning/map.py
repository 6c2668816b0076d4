"""The open-loop map (paper, Fig. 4): what was collected, and the accelerations that were learned from it.

In both, brake commands are negative, and what lies beyond the data is hatched.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

ACCELS = "RdYlBu"  # red slows down, blue speeds up
SPEEDS = "viridis"
CURVES = 6  # speeds that are drawn as curves
HATCH = "////"
UNBACKED = "dots: a gap between data; lines: beyond them"


class MapPicture(NamedTuple):
    """Samples (speed, signed command, acceleration), and the map's grid: rows of speed, columns of signed command.

    The grid's column at 0 is both pedals at rest, which is duty rest_frac. support: 1 where there are data, 0.5 in a
    gap between data, 0 beyond them.
    """

    speed_mps: Array
    command_frac: Array
    accel_mps2: Array
    grid_speed_mps: Array
    grid_command_frac: Array
    grid_accel_mps2: Array
    support: Array
    rest_frac: float


def write_map_data(path: Path, picture: MapPicture) -> Path:
    """Write the figure of `draw_map_data` to `path` as PNG."""
    return style.save(draw_map_data(picture), path)


def write_map(path: Path, picture: MapPicture) -> Path:
    """Write the figure of `draw_map` to `path` as PNG."""
    return style.save(draw_map(picture), path)


def draw_map_data(picture: MapPicture) -> Figure:
    """Fig. 4a: each sample at its speed and command, coloured by acceleration; brake on the left, throttle right."""
    figure = style.new_figure(14.0, 7.0)
    panels = figure.subplots(1, 2, sharey=True)
    limit = _limit(picture)
    dots: Any = None
    for axes, sign, name in _sides(panels):
        mine = _on_side(picture.command_frac, sign, picture.rest_frac)
        dots = axes.scatter(
            np.abs(picture.command_frac[mine]), picture.speed_mps[mine], c=picture.accel_mps2[mine], s=7.0,
            cmap=ACCELS, vmin=-limit, vmax=limit, linewidths=0.0,
        )  # fmt: skip
        pressed = int(np.sum(mine & (np.abs(picture.command_frac) > picture.rest_frac)))
        style.dress(axes, f"{name} command (duty)", "speed (m/s)" if sign < 0 else "", f"{pressed} samples")
    panels[0].invert_xaxis()
    bar = figure.colorbar(dots, ax=panels, pad=0.01)
    _label(bar, "acceleration (m/s²)")
    top = float(picture.speed_mps.max()) if picture.speed_mps.size else 0.0
    style.headline(figure, f"{picture.speed_mps.size} samples up to {top:.0f} m/s, straight and level")
    return figure


def draw_map(picture: MapPicture) -> Figure:
    """Fig. 4b: acceleration over command at several speeds with the data near them; below, the whole map.

    Curves are solid where there are data, dashed in gaps and beyond them.
    """
    figure = style.new_figure(14.0, 11.5)
    curves = figure.subplots(2, 2, sharey="row")
    limit = _limit(picture)
    colours = _curve_colours(picture)
    image: Any = None
    for column, sign, name in ((0, -1.0, "brake"), (1, 1.0, "throttle")):
        for row, colour in colours.items():
            _draw_curve(curves[0, column], picture, row, sign, colour)
        style.dress(curves[0, column], f"{name} command (duty)", "" if column else "acceleration (m/s²)")
        image = _draw_plane(curves[1, column], picture, sign, limit)
        lower = "" if column else "speed (m/s)"
        style.dress(curves[1, column], f"{name} command (duty)", lower, "" if column else UNBACKED)
        curves[1, column].grid(False)
    curves[0, 0].invert_xaxis()
    curves[1, 0].invert_xaxis()
    _label(figure.colorbar(image, ax=curves[1, :], pad=0.01), "acceleration (m/s²)")
    curves[0, 1].legend(title="at m/s", fontsize=style.FONT_PT - 1.5, title_fontsize=style.FONT_PT - 1.5, frameon=False)
    share = float(np.mean(picture.support == 1.0))
    style.headline(figure, f"The learned map; {100.0 * share:.0f} % of it backed by data, the rest dashed and hatched")
    return figure


def _sides(panels: Any) -> list[tuple[Axes, float, str]]:
    return [(panels[0], -1.0, "brake"), (panels[1], 1.0, "throttle")]


def _on_side(command: Array, sign: float, rest_frac: float) -> NDArray[np.bool_]:
    """Samples of a pedal, and those with both at rest."""
    return (command * sign > 0.0) | (np.abs(command) <= rest_frac)


def _limit(picture: MapPicture) -> float:
    """Of the colours: what hardly a sample exceeds, the same for speeding up and slowing down."""
    every = np.abs(np.concatenate([picture.accel_mps2.ravel(), picture.grid_accel_mps2.ravel()]))
    return float(np.quantile(every, 0.97)) if every.size else 1.0


def _curve_colours(picture: MapPicture) -> dict[int, Any]:
    """Rows of the grid that are drawn, spread over those with data, and their colours."""
    from matplotlib import colormaps

    backed = np.flatnonzero((picture.support == 1.0).any(axis=1))
    rows = np.unique(backed[np.linspace(0, len(backed) - 1, min(CURVES, len(backed))).astype(int)])
    colours = colormaps[SPEEDS](np.linspace(0.0, 0.9, len(rows)))
    return {int(row): tuple(colour) for row, colour in zip(rows, colours, strict=True)}


def _side_of_row(picture: MapPicture, row: int, sign: float) -> tuple[Array, Array, Array]:
    """(duty, acceleration, support) of one pedal at one speed, from rest on."""
    command = picture.grid_command_frac
    mine = command * sign >= 0.0
    duty = np.where(command[mine] == 0.0, picture.rest_frac, np.abs(command[mine]))
    order = np.argsort(duty)
    return duty[order], picture.grid_accel_mps2[row][mine][order], picture.support[row][mine][order]


def _draw_curve(axes: Axes, picture: MapPicture, row: int, sign: float, colour: Any) -> None:
    duty, accel, support = _side_of_row(picture, row, sign)
    backed = support == 1.0
    held = backed[1:] & backed[:-1]  # a stretch of curve between two nodes with data
    for i in np.flatnonzero(~held):
        axes.plot(duty[i : i + 2], accel[i : i + 2], color=colour, linestyle=(0, (2, 2)), linewidth=1.4)
    for i in np.flatnonzero(held):
        axes.plot(duty[i : i + 2], accel[i : i + 2], color=colour, linewidth=2.4)
    axes.plot([], [], color=colour, linewidth=2.4, label=f"{picture.grid_speed_mps[row]:g}")
    near = _near(picture, row) & _on_side(picture.command_frac, sign, picture.rest_frac)
    axes.plot(
        np.abs(picture.command_frac[near]), picture.accel_mps2[near], linestyle="", marker=".", markersize=3.0,
        color=colour, alpha=0.35, zorder=1,
    )  # fmt: skip


def _near(picture: MapPicture, row: int) -> NDArray[np.bool_]:
    """Samples nearer to this row's speed than to half way to the next drawn grid speed."""
    speeds = picture.grid_speed_mps
    low = 0.5 * (speeds[row] + speeds[max(row - 1, 0)])
    high = 0.5 * (speeds[row] + speeds[min(row + 1, len(speeds) - 1)])
    return (picture.speed_mps >= low) & (picture.speed_mps <= high)


def _draw_plane(axes: Axes, picture: MapPicture, sign: float, limit: float) -> Any:
    """The map from above, and hatches where no data back it."""
    command = picture.grid_command_frac
    mine = np.flatnonzero(command * sign >= 0.0)
    duty = np.where(command[mine] == 0.0, picture.rest_frac, np.abs(command[mine]))
    order = mine[np.argsort(duty)]
    duty = np.sort(duty)
    accel, support = picture.grid_accel_mps2[:, order], picture.support[:, order]
    image = axes.pcolormesh(
        duty, picture.grid_speed_mps, accel, cmap=ACCELS, vmin=-limit, vmax=limit, shading="gouraud"
    )
    if (support < 1.0).any() and min(support.shape) > 1:
        axes.contourf(
            duty, picture.grid_speed_mps, support, levels=[-0.1, 0.25, 0.75], colors="none", hatches=[HATCH, ".."]
        )
    return image


def _label(bar: Any, text: str) -> None:
    bar.set_label(text, fontsize=style.FONT_PT, color=style.INK)
    bar.ax.tick_params(labelsize=style.FONT_PT - 1.5)
