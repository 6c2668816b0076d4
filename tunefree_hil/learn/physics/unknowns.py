"""The constants of a car as unknowns of a fit: what each stands for, how far it may go, what the free runs miss.

Which constants of a car's shape a fit takes in: those that its free runs need. How late it pushes is one of them.

How well a fit of free runs knows a car's constants, where few stretches of a drive tell most of them.

A window of a drive knows what its manoeuvre moves; windows one behind the other see the same manoeuvre, and share what
the model's form lacks there. So whole stretches are taken as independent (learn/robust_least_squares.py takes each window as that),
and what the fit itself took off their residuals is given back.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from tunefree_hil.learn.data_sheet import Constant
from tunefree_hil.learn.physics.windows import TARGETS, WIDTH, Off, Window, Windows, errors, rms_of
from tunefree_hil.learn.robust_least_squares import INSIDE, WARM, Least, solve
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


# Fitted where the speed's squares are then less by a share of PAYS, and by more than chance (one standard error) has it
# from stretch to stretch. Where they explain nothing they would only take from the others what the logs know of them.
SHAPES, PAYS = ("drive_corner", "overrun_force_n", "brake_rise_per_frac", LAG), 0.1
PLAIN = "with it the squares of the missed speed are less by under a tenth, or by no more than chance"


def shaped(problem: Problem, plain: list[str], least: Least) -> tuple[list[str], Least]:
    """With those of SHAPES that pay. All at once first: where no power was found, there is no corner to find."""
    tried = [one for one in SHAPES if one in problem.names]
    if not tried:
        return plain, least
    names = [*plain, *tried]
    found = solved(problem, names, np.zeros(len(names)), 25)
    if not pays(_speed_squares(problem, plain, least.x), _speed_squares(problem, names, found.x)):
        return plain, least
    for shape in tried:
        fewer = [one for one in names if one != shape]
        without = solved(problem, fewer, np.delete(found.x, names.index(shape)), 15)
        if not pays(_speed_squares(problem, fewer, without.x), _speed_squares(problem, names, found.x)):
            names, found = fewer, without
    problem.rescale(problem.values(names, found.x))
    return names, solved(problem, names, found.x, 15)


def pays(before: Array, after: Array) -> bool:
    """Whether squares by stretch [s] are less by PAYS, and by more than one standard error. Of one stretch nobody knows
    what chance does.
    """
    gain = before - after
    if len(gain) < 2:
        return False
    chance = float(np.std(gain, ddof=1)) / math.sqrt(len(gain))
    return float(gain.mean()) > max(PAYS * float(before.mean()), chance)


def _speed_squares(problem: Problem, names: Sequence[str], x: Array) -> Array:
    """Mean square by which the speed is missed, by stretch that saw it."""
    misses = problem.misses(problem.values(names, x))[:, :, TARGETS.index("speed_mps")]
    at = stretches_of(problem.some)
    by_stretch = (misses[at == one] ** 2 for one in np.unique(at))
    return np.array([np.nanmean(one) for one in by_stretch if np.isfinite(one).any()])


STRETCH = 3  # windows one behind the other: they see one manoeuvre, and share what the model's form lacks there
LEAST_STRETCHES = 4  # of which something can be told; of fewer each window is one
LEAST_LEFT = 1e-6  # of a stretch's residuals that the fit can have left in them


class Together(NamedTuple):
    """What a fit does not know of some constants goes together: names [p], correlation [p, p] of what they are off by
    (of the logarithm of what is a factor).
    """

    names: tuple[str, ...] = ()
    correlation: Array = np.zeros((0, 0))


def deviations_left(least: Least) -> Array:
    """What is left of each unknown's doubt (1 before the fit), with the windows' own scatter where that is wider."""
    inner = np.linalg.pinv(least.jacobian.T @ least.jacobian, hermitian=True)
    return np.maximum(np.sqrt(np.maximum(np.diag(inner), 0.0)), least.deviation)


def stretches_of(some: Sequence[Window]) -> Array:
    """The stretch of each window [windows]: STRETCH of a drive, one behind the other; the window where they are few."""
    found, stretch, held = np.zeros(len(some), dtype=int), -1, 0
    for i, window in enumerate(some):
        if i == 0 or window.name != some[i - 1].name or held == STRETCH:
            stretch, held = stretch + 1, 0
        found[i], held = stretch, held + 1
    return found if stretch + 1 >= LEAST_STRETCHES else np.arange(len(some))


def doubts_left(least: Least, stretches: Array) -> Array:
    """Half of each unknown's 95 % interval, in what was doubted before the fit (1: one standard deviation of that).

    What a fit leaves of a stretch's residuals is less than its error, and the more so the more it told the fit: taken
    as they are, the few stretches that know the tyres would vouch for themselves. They are set right by what the fit
    took off them (Bell and McCaffrey 2002), stretch by stretch (`stretches` [n], of each residual that is data).
    """
    pulls = _pulls(least, stretches)
    count = len(pulls)
    scatter = np.sqrt(np.sum(pulls * pulls, axis=0) * (count / (count - 1)))
    wide = float(student.ppf(0.975, count - 1)) * scatter
    return np.minimum(np.maximum(wide, least.quantile * deviations_left(least)), least.quantile)


def together(names: Sequence[str], least: Least, stretches: Array) -> Together:
    """How the unknowns' doubts hang together: half as the fit's own curvature says, half as its stretches do. The first
    knows which of them only their sum is known of; the second, of so few, also what goes together by chance.
    """
    pulls = _pulls(least, stretches)
    inner = np.linalg.pinv(least.jacobian.T @ least.jacobian, hermitian=True)
    return Together(tuple(names), 0.5 * (_correlation(inner) + _correlation(pulls.T @ pulls)))


def _correlation(covariance: Array) -> Array:
    size = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    found = covariance / np.outer(size, size)
    np.fill_diagonal(found, 1.0)
    return found


def _pulls(least: Least, stretches: Array) -> Array:
    """By how much each stretch pulls the unknowns [stretches, p], its residuals as large as its errors are."""
    inner = np.linalg.pinv(least.jacobian.T @ least.jacobian, hermitian=True)
    root = np.linalg.cholesky(inner)
    every = np.unique(stretches)
    pulls = np.zeros((len(every), len(inner)))
    for i, one in enumerate(every):
        rows = np.flatnonzero(stretches == one)
        here, miss = least.jacobian[rows], least.residuals[rows]
        basis, size, _ = np.linalg.svd(here @ root, full_matrices=False)
        more = 1.0 / np.sqrt(np.maximum(1.0 - size * size, LEAST_LEFT)) - 1.0
        pulls[i] = inner @ (here.T @ (miss + basis @ (more * (basis.T @ miss))))
    return pulls
