"""Fits the physical constants of plant/single_track.py by free runs (design D5).

Each window starts where the car was measured to be and runs free on the recorded actuator outputs; what counts is how
far speed, yaw rate, heading, lateral acceleration and position then are from the measured ones. Masses and geometry
stay the data sheet's: a fit sees forces per mass only. A constant that the windows do not tell much better than it was
known before keeps its data sheet's value, widened.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.least import INSIDE, WARM, Least, solve
from tunefree_hil.learn.physics_doubts import Together, deviations_left, doubts_left, stretches_of, together
from tunefree_hil.learn.sheet import Constant
from tunefree_hil.learn.values import Value, together_with
from tunefree_hil.learn.window_runs import WIDTH, Off, errors, rms_of
from tunefree_hil.learn.windows import TARGETS, Windows
from tunefree_hil.plant.constants import LEAST

Array = np.ndarray

# No constants of the plant, but of effects (interfaces 4): the steering wheel's straight ahead, and the brake's first
# stretch that does nothing, which no report shows.
OFFSET, BAND = "steer_offset_rad", "brake_dead_band_frac"
OFFSET_DOUBT_RAD = 0.1
BAND_DOUBT = 0.2  # of the brake's way
# The logs' and not the car's: of what their accelerometer says throughout, the part that is a slope.
ROAD, ROAD_DOUBT = "road_share", 2.0
EFFECTS = {OFFSET: ("steer_offset", "offset_rad", 0.005), BAND: ("brake_dead_band", "half_width_frac", 0.002)}
LATERAL = ("front_stiffness_n_per_rad", "rear_stiffness_n_per_rad", "yaw_inertia_kgm2", "steer_ratio",
           "linkage_bend", OFFSET)  # fmt: skip
AT_LEAST = {BAND: 0.0, "overrun_force_n": 0.0, **LEAST}
FIRST_SCALE = {
    "speed_mps": 0.2, "yaw_rate_radps": 0.01, "heading_rad": 0.02, "lateral_accel_mps2": 0.3, "x_m": 0.7, "y_m": 0.7,
}  # fmt: skip
LEAST_WINDOWS = 6
STEPS = 8  # that are told of a fit, however many there are
PIECES = 4.0  # independent numbers that a window has to say of each target
ROBUST = 3.0
KNOWN_SHARE = 0.5  # of the doubt before the fit that may be left after it
HOPELESS = 0.95  # of it: nothing at all was learned
WORSE = 1.5  # than with all constants free, from which on what was known before is not gone back to
TOGETHER = "these logs tell it only together with the others: the best of all together"
MOST = 6.0  # halves of a constant's doubt that a fit may go
FLOOR = 0.02  # of the first scale: no target is believed better than that


class PhysicsFit(NamedTuple):
    """params: [plant.params] in full. values: the fitted constants, and those of EFFECTS.

    before, after: root mean square of each target over the windows, data sheet and fit. together: of the doubts.
    """

    values: dict[str, Value]
    params: dict[str, float]
    before: dict[str, float]
    after: dict[str, float]
    windows: int
    words: tuple[str, ...]
    together: Together = Together()

    def off(self) -> Off:
        """What lies between outputs and car; only what is clear (is_clear) goes into a model."""
        found = {name: self.values[name].value if is_clear(name, self.values[name]) else 0.0 for name in EFFECTS}
        road = self.values.get(ROAD)
        return Off(float(found[OFFSET]), float(found[BAND]), road.value if road is not None and road.known else 0.0)


def is_clear(name: str, value: Value) -> bool:
    """Whether one of EFFECTS is there: off zero by more than the doubt about it, and by more than a trifle."""
    return value.known and (value.low > 0.0 or value.high < 0.0) and abs(value.value) > EFFECTS[name][2]


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
        }
        if any(window.standing for window in self.some):
            self.known[ROAD] = Constant(0.0, ROAD_DOUBT, False, False)
        names = list(self.known)
        if "brake_force_n_per_frac" not in known:  # no brake, or none that anybody sees
            names.remove(BAND)
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
        off = Off(float(values[OFFSET]), float(values[BAND]), float(values.get(ROAD, 0.0)))
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


def fit(
    windows: Windows, fixed: Mapping[str, float], known: Mapping[str, Constant], brake_way: float
) -> Generator[Any, None, PhysicsFit]:
    """Fit what the windows show; yields (done, total). brake_way: duty from rest to the limit.

    Raises InputError where there are too few windows.
    """
    if not windows.pedals and len(windows.some) < LEAST_WINDOWS:
        return _unfitted(windows, fixed, known, brake_way)
    if len(windows.some) < LEAST_WINDOWS:
        raise InputError(
            f"the logs hold {len(windows.some)} windows of free motion, {LEAST_WINDOWS} are needed"
            + "".join(f"; {words}" for words in windows.words),
            code="too_short",
            key="LOG",
            hint="drive longer, in drive gear, with reports of the actuators and of the speed",
        )
    problem = Problem(windows, fixed, known, brake_way)
    names, x = list(problem.names), np.zeros(len(problem.names))
    before = rms_of(problem.misses(problem.values(names, x)))
    yield 0, STEPS
    least = _solved(problem, names, x, 25)
    yield 1, STEPS
    problem.rescale(problem.values(names, least.x))
    least = _solved(problem, names, least.x, 15)
    yield 2, STEPS
    joint, jointly = problem.values(names, least.x), rms_of(problem.misses(problem.values(names, least.x)))
    first = names, least
    doubts = dict(zip(names, doubts_left(least, problem.stretches), strict=True))
    related = together(names, least, problem.stretches)
    names, least, lost = yield from _told(problem, names, least)
    values = problem.values(names, least.x if names else np.zeros(0))
    after = rms_of(problem.misses(values))
    yield STEPS, STEPS
    if names and lost:  # held where they were known before, they would lend the others a certainty that nobody has
        alone = dict(zip(names, doubts_left(least, problem.stretches), strict=True))
        doubts = {name: max(doubts[name], one) for name, one in alone.items()}
    found = {name: _value(problem, names, least, name, doubts, lost) for name in problem.known}
    if any(after[name] > WORSE * jointly[name] for name in after):  # what was known before is no car that drives so
        values, after = joint, jointly
        found = {name: together_with(one, joint[name], TOGETHER) for name, one in found.items()}
        found |= _known_jointly(problem, *first)
    return PhysicsFit(found, problem.params(values), before, after, len(windows.some), windows.words, related)


def _known_jointly(problem: Problem, names: list[str], least: Least) -> dict[str, Value]:
    """Constants that the windows tell while all the others are free: they are no less known for one that is not."""
    doubts = dict(zip(names, doubts_left(least, problem.stretches), strict=True))
    left = dict(zip(names, deviations_left(least), strict=True))
    return {name: _value(problem, names, least, name, doubts, {}) for name in names if left[name] <= KNOWN_SHARE}


def _told(
    problem: Problem, names: list[str], least: Least
) -> Generator[Any, None, tuple[list[str], Least, dict[str, float]]]:
    """(constants that the windows tell, their fit, what is left of the doubt about each of the others): what they do
    not tell is held where it was known before, and the rest fitted again.
    """
    lost: dict[str, float] = {}
    while names:
        left = deviations_left(least)
        worst = np.flatnonzero((left > KNOWN_SHARE) & (left >= min(HOPELESS, float(left.max()))))
        if not len(worst):
            break
        lost |= {names[i]: float(left[i]) for i in worst}  # all that are hopeless at once, else the worst alone
        keep = [i for i in range(len(names)) if i not in worst]
        names = [names[i] for i in keep]
        if names:
            least = _solved(problem, names, least.x[keep], 10)
        yield min(3 + len(lost), STEPS - 1), STEPS
    return names, least, lost


def _unfitted(
    windows: Windows, fixed: Mapping[str, float], known: Mapping[str, Constant], brake_way: float
) -> PhysicsFit:
    """No pedal's output is reported and there is little else: all as it was known before."""
    problem = Problem(windows._replace(some=()), fixed, known, brake_way)
    values = problem.values((), np.zeros(0))
    found = {name: _taken(problem, name, {}) for name in problem.known}
    words = f"no pedal's output is reported, and only {len(windows.some)} free runs can be made: no constant is fitted"
    return PhysicsFit(found, problem.params(values), {}, {}, 0, (words,))


def _solved(problem: Problem, names: Sequence[str], x: Array, most: int) -> Least:
    high = np.full(len(names), MOST)
    low = np.array([problem.least(name) for name in names])
    robust = ROBUST * math.sqrt(PIECES / problem.rows)  # of a residual as it is scaled here
    inside = WARM if x.any() else INSIDE
    run = partial(problem.residuals, names)
    return solve(run, x, low, high, problem.blocks, robust=robust, most=most, priors=len(names), inside=inside)


def _value(
    problem: Problem, names: Sequence[str], least: Least, name: str, doubts: Mapping[str, float],
    lost: Mapping[str, float],
) -> Value:  # fmt: skip
    if name in names:
        x, half = float(least.x[names.index(name)]), float(doubts[name])
        low = max(x - half, problem.least(name))
        return Value(problem.value(name, x), problem.value(name, low), problem.value(name, x + half))
    return _taken(problem, name, lost)


def _taken(problem: Problem, name: str, lost: Mapping[str, float]) -> Value:
    constant = problem.known[name]
    low, high = constant.ends()
    low = max(low, AT_LEAST.get(name, -math.inf))
    source = "data sheet" if constant.stated else "a plausible value"
    if name in lost:
        why = f"these logs leave {min(lost[name], 1.0):.0%} of the doubt there was"
    else:
        why = "the logs lack the outputs that move it"
    return Value(constant.value, low, high, False, f"{why}; {source}")
