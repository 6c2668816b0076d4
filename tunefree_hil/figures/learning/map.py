"""Figures of the open-loop map (paper, Fig. 4): the samples, and the accelerations learned from them.

Brake commands are negative in the data; areas without data are hatched.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

ACCEL_COLOURS = "RdYlBu"  # red slows down, blue speeds up
SPEED_COLOURS = "viridis"
PEDALS = ((-1.0, "brake"), (1.0, "throttle"))  # sign of the command in the data, and name
CURVES = 6  # number of speeds drawn as curves
HATCH = "////"
UNBACKED = "dots: a gap between data; lines: beyond the data"


class MapPicture(NamedTuple):
    """Samples and grid of a map.

    Samples have the shape (n_samples,), the grid (n_speeds, n_commands). Commands are signed (brake negative); 0: both
    pedals at rest, which is duty rest_frac. support: 1 where there are data, 0.5 in a gap between data, 0 beyond them.
    """

    speed_mps: Array
    command_frac: Array
    accel_mps2: Array
    grid_speed_mps: Array
    grid_command_frac: Array
    grid_accel_mps2: Array
    support: Array
    rest_frac: float


def draw_map_data(picture: MapPicture) -> Figure:
    """Draw Fig. 4a: each sample at its speed and command, coloured by acceleration; brake left, throttle right."""
    figure = style.new_figure(14.0, 7.0)
    panels = figure.subplots(1, 2, sharey=True)
    limit = _colour_limit(picture)
    dots: Any = None
    for axes, (sign, name) in zip(panels, PEDALS, strict=True):
        of_pedal = _is_pedal_sample(picture.command_frac, sign, picture.rest_frac)
        dots = axes.scatter(
            np.abs(picture.command_frac[of_pedal]), picture.speed_mps[of_pedal], c=picture.accel_mps2[of_pedal], s=7.0,
            cmap=ACCEL_COLOURS, vmin=-limit, vmax=limit, linewidths=0.0,
        )  # fmt: skip
        pressed = int(np.sum(of_pedal & (np.abs(picture.command_frac) > picture.rest_frac)))
        style.dress(axes, f"{name} command (duty)", "speed (m/s)" if sign < 0 else "", f"{pressed} samples")
    panels[0].invert_xaxis()
    bar = figure.colorbar(dots, ax=panels, pad=0.01)
    _label_colour_bar(bar, "acceleration (m/s²)")
    top = float(picture.speed_mps.max()) if picture.speed_mps.size else 0.0
    style.headline(figure, f"{picture.speed_mps.size} samples up to {top:.0f} m/s, straight and level")
    return figure


def draw_map(picture: MapPicture) -> Figure:
    """Draw Fig. 4b: acceleration over command at several speeds with the samples near them; below, the whole map.

    Curves are solid where there are data, dashed elsewhere.
    """
    figure = style.new_figure(14.0, 11.5)
    curves = figure.subplots(2, 2, sharey="row")
    limit = _colour_limit(picture)
    colours = _curve_colours(picture)
    image: Any = None
    for column, (sign, name) in enumerate(PEDALS):
        for row, colour in colours.items():
            _draw_curve(curves[0, column], picture, row, sign, colour)
        style.dress(curves[0, column], f"{name} command (duty)", "" if column else "acceleration (m/s²)")
        image = _draw_plane(curves[1, column], picture, sign, limit)
        lower = "" if column else "speed (m/s)"
        style.dress(curves[1, column], f"{name} command (duty)", lower, "" if column else UNBACKED)
        curves[1, column].grid(False)
    curves[0, 0].invert_xaxis()
    curves[1, 0].invert_xaxis()
    _label_colour_bar(figure.colorbar(image, ax=curves[1, :], pad=0.01), "acceleration (m/s²)")
    curves[0, 1].legend(title="at m/s", fontsize=style.FONT_PT - 1.5, title_fontsize=style.FONT_PT - 1.5, frameon=False)
    share = float(np.mean(picture.support == 1.0))
    style.headline(figure, f"The learned map; {100.0 * share:.0f} % of it backed by data, the rest dashed and hatched")
    return figure


def _is_pedal_sample(command: Array, sign: float, rest_frac: float) -> NDArray[np.bool_]:
    """Samples of one pedal, and those with both pedals at rest."""
    return (command * sign > 0.0) | (np.abs(command) <= rest_frac)


def _colour_limit(picture: MapPicture) -> float:
    """Limit of the colour scale: the 97 % quantile of all accelerations, the same for both signs."""
    accelerations = np.abs(np.concatenate([picture.accel_mps2.ravel(), picture.grid_accel_mps2.ravel()]))
    return float(np.quantile(accelerations, 0.97)) if accelerations.size else 1.0


def _curve_colours(picture: MapPicture) -> dict[int, Any]:
    """Rows of the grid to draw, spread over those with data, and their colours."""
    from matplotlib import colormaps

    backed = np.flatnonzero((picture.support == 1.0).any(axis=1))
    rows = np.unique(backed[np.linspace(0, len(backed) - 1, min(CURVES, len(backed))).astype(int)])
    colours = colormaps[SPEED_COLOURS](np.linspace(0.0, 0.9, len(rows)))
    return {int(row): tuple(colour) for row, colour in zip(rows, colours, strict=True)}


def _pedal_columns(picture: MapPicture, sign: float) -> tuple[Array, NDArray[np.int64]]:
    """Duties of one pedal in the grid from rest on, and their columns."""
    command = picture.grid_command_frac
    of_pedal = np.flatnonzero(command * sign >= 0.0)
    duty = np.where(command[of_pedal] == 0.0, picture.rest_frac, np.abs(command[of_pedal]))
    return np.sort(duty), of_pedal[np.argsort(duty)]


def _draw_curve(axes: Axes, picture: MapPicture, row: int, sign: float, colour: Any) -> None:
    duty, columns = _pedal_columns(picture, sign)
    accel, backed = picture.grid_accel_mps2[row, columns], picture.support[row, columns] == 1.0
    is_backed_segment = backed[1:] & backed[:-1]  # between two nodes with data
    for i in np.flatnonzero(~is_backed_segment):
        axes.plot(duty[i : i + 2], accel[i : i + 2], color=colour, linestyle=(0, (2, 2)), linewidth=1.4)
    for i in np.flatnonzero(is_backed_segment):
        axes.plot(duty[i : i + 2], accel[i : i + 2], color=colour, linewidth=2.4)
    axes.plot([], [], color=colour, linewidth=2.4, label=f"{picture.grid_speed_mps[row]:g}")
    near_samples = _is_near_row(picture, row) & _is_pedal_sample(picture.command_frac, sign, picture.rest_frac)
    dots = {"linestyle": "", "marker": ".", "markersize": 3.0, "alpha": 0.35, "zorder": 1}
    axes.plot(np.abs(picture.command_frac[near_samples]), picture.accel_mps2[near_samples], color=colour, **dots)


def _is_near_row(picture: MapPicture, row: int) -> NDArray[np.bool_]:
    """Samples that lie nearer to the speed of this row than to that of the next."""
    speeds = picture.grid_speed_mps
    low = 0.5 * (speeds[row] + speeds[max(row - 1, 0)])
    high = 0.5 * (speeds[row] + speeds[min(row + 1, len(speeds) - 1)])
    return (picture.speed_mps >= low) & (picture.speed_mps <= high)


def _draw_plane(axes: Axes, picture: MapPicture, sign: float, limit: float) -> Any:
    """Draw the map over speed and command, hatched where there are no data."""
    duty, columns = _pedal_columns(picture, sign)
    accel, support = picture.grid_accel_mps2[:, columns], picture.support[:, columns]
    image = axes.pcolormesh(
        duty, picture.grid_speed_mps, accel, cmap=ACCEL_COLOURS, vmin=-limit, vmax=limit, shading="gouraud"
    )
    if (support < 1.0).any() and min(support.shape) > 1:
        axes.contourf(
            duty, picture.grid_speed_mps, support, levels=[-0.1, 0.25, 0.75], colors="none", hatches=[HATCH, ".."]
        )
    return image


def _label_colour_bar(bar: Any, text: str) -> None:
    bar.set_label(text, fontsize=style.FONT_PT, color=style.INK)
    bar.ax.tick_params(labelsize=style.FONT_PT - 1.5)
