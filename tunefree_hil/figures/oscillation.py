"""The steering wheel of one drive: what the reference does not explain, over time and as a spectrum."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.figures import style
from tunefree_hil.grade.oscillation.residual import HIGH_PASS_HZ, LOW_PASS_HZ

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SEGMENT_S = 10.0  # of the drive over which a spectrum is taken; the panel shows their mean
SHOWN_HZ = (0.1, 10.0)
DECADES = 4.0  # shown below the largest density
WHEEL, RESIDUAL = style.OTHERS[3], style.TUNED


class WheelPicture(NamedTuple):
    """The wheel and its residual in deg, sampled every dt_s. message: the figure's title.

    span_s: from when to when the worst oscillation goes on; None where there is none.
    """

    message: str
    wheel_deg: NDArray[np.float64]
    residual_deg: NDArray[np.float64]
    dt_s: float
    span_s: tuple[float, float] | None


def draw_oscillation(picture: WheelPicture) -> Figure:
    """Residual over time, with the span of the worst oscillation, and amplitude spectral densities with the band."""
    figure = style.new_figure(13.0, 7.0)
    upper, lower = figure.add_subplot(2, 1, 1), figure.add_subplot(2, 1, 2)
    times_s = np.arange(len(picture.residual_deg)) * picture.dt_s
    style.line(upper, times_s, picture.residual_deg, RESIDUAL._replace(marker=""))
    if picture.span_s is not None:
        upper.axvspan(*picture.span_s, color=style.MANUAL.colour, alpha=0.15, lw=0)
    band = f"{LOW_PASS_HZ:g} to {HIGH_PASS_HZ:g} Hz"
    style.dress(upper, "time (s)", "wheel (°)", f"what the reference does not explain, {band}; shaded: the worst swing")
    _draw_spectrum(lower, picture)
    style.legend_below(figure, lower, 2)
    style.headline(figure, picture.message)
    return figure


def amplitude_density(values: NDArray[np.float64], dt_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frequencies in Hz and the one-sided amplitude spectral density, mean over half overlapping Hann segments."""
    length = min(len(values), round(SEGMENT_S / dt_s))
    window = np.hanning(length)
    starts = range(0, len(values) - length + 1, max(1, length // 2))
    segments = [values[start : start + length] for start in starts]
    spectra = [np.fft.rfft(window * (segment - segment.mean())) for segment in segments]
    power = np.mean([np.abs(spectrum) ** 2 for spectrum in spectra], axis=0) * 2.0 * dt_s / np.sum(window * window)
    return np.fft.rfftfreq(length, dt_s).astype(np.float64), np.sqrt(power)


def _draw_spectrum(axes: Axes, picture: WheelPicture) -> None:
    largest = 0.0
    for values, look, label in (
        (picture.wheel_deg, WHEEL, "wheel"),
        (picture.residual_deg, RESIDUAL, "what the reference does not explain"),
    ):
        frequency_hz, density = amplitude_density(values, picture.dt_s)
        shown = (frequency_hz >= SHOWN_HZ[0]) & (frequency_hz <= SHOWN_HZ[1])
        style.line(axes, frequency_hz[shown], density[shown], look._replace(marker="", dash="-"), label)
        largest = max(largest, float(density[shown].max(initial=0.0)))
    axes.axvspan(LOW_PASS_HZ, HIGH_PASS_HZ, color=style.FAINT, alpha=0.15, lw=0)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(*SHOWN_HZ)
    if largest > 0.0 and math.isfinite(largest):
        axes.set_ylim(largest * 10.0**-DECADES, 2.0 * largest)
    style.plain_numbers(axes.xaxis)
    style.dress(axes, "frequency (Hz)", "density (°/√Hz)", "amplitude spectral density; grey: the band of oscillations")
