"""The constants of a car as unknowns of a fit: what each stands for, how far it may go, what the free runs miss."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from tunefree_hil.learn.least import INSIDE, WARM, Least, solve
from tunefree_hil.learn.physics_doubts import stretches_of
from tunefree_hil.learn.sheet import Constant
from tunefree_hil.learn.window_runs import WIDTH, Off, errors, rms_of
from tunefree_hil.learn.windows import TARGETS, Windows
from tunefree_hil.plant.constants import LEAST

Array = np.ndarray

# No constants of the plant, but of effects (interfaces 4): the steering wheel's straight ahead, the brake's first
# stretch that does nothing, and how much later and softer than its throttle says a car pushes, which no report shows.
OFFSET, BAND, LAG = "steer_offset_rad", "brake_dead_band_frac", "powertrain_lag_s"
OFFSET_DOUBT_RAD = 0.1
BAND_DOUBT = 0.2  # of the brake's way
LAG_DOUBT_S = 0.5  # engines and their gears: 0.1 to 0.5 s
# The logs' and not the car's: of what their accelerometer says throughout, the part that is a slope.
ROAD, ROAD_DOUBT = "road_share", 2.0
# name -> (effect, its parameter, what is a trifle)
EFFECTS = {
    OFFSET: ("steer_offset", "offset_rad", 0.005),
    BAND: ("brake_dead_band", "half_width_frac", 0.002),
    LAG: ("powertrain_lag", "tau_s", 0.02),
}
LATERAL = ("front_stiffness_n_per_rad", "rear_stiffness_n_per_rad", "yaw_inertia_kgm2", "steer_ratio",
           "linkage_bend", OFFSET)  # fmt: skip
AT_LEAST = {BAND: 0.0, LAG: 0.0, "overrun_force_n": 0.0, **LEAST}
FIRST_SCALE = {
    "speed_mps": 0.2, "yaw_rate_radps": 0.01, "heading_rad": 0.02, "lateral_accel_mps2": 0.3, "x_m": 0.7, "y_m": 0.7,
}  # fmt: skip
PIECES = 4.0  # independent numbers that a window has to say of each target
ROBUST = 3.0
MOST = 6.0  # halves of a constant's doubt that a fit may go
FLOOR = 0.02  # of the first scale: no target is believed better than that


class Problem:
    """Unknowns are the constants in units of half their doubt, 0 being what was known before."""

    def __init__(
        self, windows: Windows, fixed: Mapping[str, float], known: Mapping[str, Constant], brake_way: float
    ) -> None:
        self.some = windows.some
        self.fixed = dict(fixed)
        self.known = {
            **known,
            OFFSET: Constant(0.0, OFFSET_DOUBT_RAD, False, False),
            BAND: Constant(0.0, BAND_DOUBT * brake_way, False, False),
            LAG: Constant(0.0, LAG_DOUBT_S, False, False),
        }
        if any(window.standing for window in self.some):
            self.known[ROAD] = Constant(0.0, ROAD_DOUBT, False, False)
        names = list(self.known)
        if "brake_force_n_per_frac" not in known:  # no brake, or none that anybody sees
            names.remove(BAND)
        if "drive_force_n" not in known:  # asked for an acceleration: its channel has the lag of all that moves it
            names.remove(LAG)
        if not windows.steered:
            names = [name for name in names if name not in LATERAL]
        if not windows.pedals:
            names = [name for name in names if name in LATERAL]
        self.names = names
        self.scale = np.array([FIRST_SCALE[name] for name in TARGETS])
        seen = np.concatenate(
            [np.isfinite(window.targets).ravel() for window in self.some] or [np.zeros(0, dtype=bool)]
        )
        self.seen = seen
        self.rows = len(self.some[0].at) if self.some else 0
        self.blocks = np.repeat(np.arange(len(self.some)), self.rows * WIDTH)[seen]
        self.stretches = np.repeat(stretches_of(self.some), self.rows * WIDTH)[seen]

    def value(self, name: str, unknown: float) -> float:
        """The constant that an unknown stands for."""
        constant = self.known[name]
        if constant.logarithmic:
            return constant.value * math.exp(0.5 * unknown * math.log(constant.doubt))
        return constant.value + 0.5 * unknown * constant.doubt

    def least(self, name: str) -> float:
        """The least unknown of a constant."""
        constant = self.known[name]
        return max(2.0 * (AT_LEAST[name] - constant.value) / constant.doubt, -MOST) if name in AT_LEAST else -MOST

    def values(self, names: Sequence[str], x: Array) -> dict[str, float]:
        """All constants, those not in `names` as they were known before."""
        found = {name: constant.value for name, constant in self.known.items()}
        return found | {name: self.value(name, float(one)) for name, one in zip(names, x, strict=True)}

    def params(self, values: Mapping[str, float]) -> dict[str, float]:
        """[plant.params] in full."""
        return self.fixed | {name: value for name, value in values.items() if name not in (*EFFECTS, ROAD)}

    def misses(self, values: Mapping[str, float]) -> Array:
        """[windows, m, 6], not scaled."""
        off = Off(float(values[OFFSET]), float(values[BAND]), float(values.get(ROAD, 0.0)), float(values[LAG]))
        return errors(self.params(values), off, self.some)

    def residuals(self, names: Sequence[str], x: Array) -> Array:
        """Scaled so that each window has PIECES of each target to say; then what was known before."""
        share = math.sqrt(PIECES / self.rows)
        rows = (self.misses(self.values(names, x)) / self.scale).ravel()[self.seen] * share
        return np.concatenate([np.nan_to_num(rows, nan=1e3, posinf=1e3, neginf=-1e3), x])

    def rescale(self, values: Mapping[str, float]) -> None:
        """Take as 1 what is usual now: the root mean square error of each target."""
        for name, error in rms_of(self.misses(values)).items():
            self.scale[TARGETS.index(name)] = max(error, FLOOR * FIRST_SCALE[name])


def solved(problem: Problem, names: Sequence[str], x: Array, most: int) -> Least:
    """From x, as robustly as ROBUST says; near a solution already where x is one."""
    high = np.full(len(names), MOST)
    low = np.array([problem.least(name) for name in names])
    robust = ROBUST * math.sqrt(PIECES / problem.rows)  # of a residual as it is scaled here
    inside = WARM if x.any() else INSIDE
    run = partial(problem.residuals, names)
    return solve(run, x, low, high, problem.blocks, robust=robust, most=most, priors=len(names), inside=inside)
