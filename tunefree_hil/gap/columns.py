"""The signals of a drive under names that measured and simulated ones share, smoothed and sloped alike.

`travel` is the summed-up rate of speed of the simulation, and the speed of the measurement: its slope over a short
window is the acceleration of either.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import savgol_coeffs

from tunefree_hil.gap.chain import Opened
from tunefree_hil.gap.graph import CHANNELS
from tunefree_hil.gap.lost import OUTPUTS
from tunefree_hil.gap.ride import SHOWN
from tunefree_hil.gap.signals import Signal

Array = np.ndarray

WINDOW_S = 0.21  # of the polynomials; delays of a few hundredths still show through it
COLUMN = {name: i for i, name in enumerate(SHOWN)}
FIELDS = {
    "speed_mps": "report.speed_mps",
    "yaw_rate_radps": "report.yaw_rate_radps",
    "accel_mps2": "report.accel_mps2",
    "lateral_accel_mps2": "report.lateral_accel_mps2",
    "ins_speed_mps": "ins.speed_mps",
    "ins_yaw_rate_radps": "ins.yaw_rate_radps",
}


@cache
def _taps(window: int, derivative: int, dt_s: float) -> Array:
    """Of a parabola fitted to a window; at the ends of a drive, where none fits, nothing is compared."""
    return np.asarray(savgol_coeffs(window, 2, deriv=derivative, delta=dt_s))


@cache
def _under_slope(window: int) -> Array:
    """The weights [window] that a slope (a parabola's) gives the rates whose sum it is the slope of."""
    taps = np.cumsum(savgol_coeffs(window, 2, deriv=1, use="dot"))[:-1]
    return -0.5 * np.convolve(taps, [1.0, 1.0])


class Columns:
    """The signals of a drive, simulated or measured, by the names of SHOWN; `travel` beside them."""

    def __init__(self, columns: dict[str, Array], dt_s: float) -> None:
        self.columns, self.dt_s = columns, dt_s
        self.window = max(round(WINDOW_S / dt_s) | 1, 5)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def mean(self, values: Array) -> Array:
        """Smoothed."""
        return convolve1d(values, _taps(self.window, 0, self.dt_s), mode="nearest")

    def slope(self, values: Array) -> Array:
        """Rate per s of the smoothed signal."""
        return convolve1d(values, _taps(self.window, 1, self.dt_s), mode="nearest")


def measured_columns(opened: Opened) -> Columns:
    """What was measured, as far as it was."""
    found = {name: opened.signals[field].values for name, field in FIELDS.items() if field in opened.signals}
    source = "ins.speed_mps" if opened.inputs.by_ins else "report.speed_mps"
    found["travel"] = opened.signals[source].values
    for i, name in enumerate(CHANNELS):
        found[OUTPUTS[name]] = opened.inputs.outputs[:, i]
    return Columns(found, opened.dt_s)


def noisier(columns: Columns, opened: Opened) -> Columns:
    """What was measured with as much white noise again as each sensor has, as often as it speaks: what comes seldom is
    no quieter for lying between two values on a straight line. The draw is the same each time.
    """
    rng, found = np.random.default_rng(1), dict(columns.columns)
    for name, field in FIELDS.items():
        if field in opened.signals:
            found[name] = columns[name] + _noise_like(opened.signals[field], rng)
    found["travel"] = found["ins_speed_mps" if opened.inputs.by_ins else "speed_mps"]
    return Columns(found, opened.dt_s)


def _noise_like(signal: Signal, rng: np.random.Generator) -> Array:
    """[n]: white in what was told, and moved as that was; nothing of a signal that is all gaps."""
    at = np.flatnonzero(signal.fresh & signal.there)
    if not len(at):
        return np.zeros(len(signal.values))
    return np.interp(np.arange(len(signal.values)), at - signal.late, signal.noise * rng.standard_normal(len(at)))


def simulated_columns(shown: Array, opened: Opened) -> Columns:
    """What the graph showed."""
    found = {name: shown[:, i] for name, i in COLUMN.items()}
    rate = shown[:, COLUMN["ins_accel_mps2" if opened.inputs.by_ins else "rate_mps2"]]
    found["travel"] = np.cumsum(rate) * opened.dt_s
    for name, field in (*FIELDS.items(), ("travel", "ins.speed_mps" if opened.inputs.by_ins else "report.speed_mps")):
        window = opened.derived.get(field, 1)
        if window > 1:  # what was made of a pose is a slope over several values: so is what it is held against
            found[name] = convolve1d(found[name], _under_slope(window), mode="nearest")
        elif field in opened.signals:
            found[name] = opened.signals[field].as_seldom(found[name])
    return Columns(found, opened.dt_s)
