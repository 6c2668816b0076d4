"""Robustness margins, failure rates and steering activity of a controller, from the outcomes of simulated drives.

Pure functions: the car variants, the order in which they are driven (`MarginSearch`), and the evaluation. A drive fails
where it is not driven to its end (|lateral error| above half the lane width of 4 m, or divergence); it is clean where
it neither fails nor re-plans. A margin is the first value at which a drive is not clean; 0 is no margin.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.grade.score import FINISHED

MAX_NEAR_NOMINAL = 0.2  # no failure is accepted where all factors are within 1 +/- this value
FACTOR_TOLERANCE = 1e-9  # factors closer than this count as equal
MIN_REVERSAL_RAD = math.radians(1.0)  # of the steering wheel: ten steps of a usual by-wire quantisation


class CarVariant(NamedTuple):
    """A car that differs from its model by factors and by an additional steering dead time.

    lag, dead_time: of all actuators. friction: between tyre and road. steer_gain: road wheels over reported angle.
    """

    mass: float = 1.0
    lag: float = 1.0
    dead_time: float = 1.0
    friction: float = 1.0
    steer_gain: float = 1.0
    steer_delay_s: float = 0.0


class DriveOutcome(NamedTuple):
    """Outcome of one drive ('finished' or the name of what ended it) and its number of re-plans."""

    outcome: str
    replans: int

    @property
    def is_failed(self) -> bool:
        return self.outcome != FINISHED

    @property
    def is_clean(self) -> bool:
        return not self.is_failed and self.replans == 0


class Margin(NamedTuple):
    """The first value at which a drive was not clean, its scenario, and what happened there.

    at_least: no such drive up to `value`, where the search ends; scenario and what are then ''.
    """

    value: float
    at_least: bool = False
    scenario: str = ""
    what: str = ""


class FailureRate(NamedTuple):
    """Number of failed drives and of all drives."""

    failed: int
    drives: int

    @property
    def share(self) -> float:
        return self.failed / self.drives if self.drives else math.nan


class SteeringActivity(NamedTuple):
    """RMS of the rate of the steering command (steering wheel), and its reversals per second."""

    rate_rms_radps: float
    reversals_per_s: float


NOMINAL = CarVariant()


def _vary_one(name: str, *factors: float) -> tuple[CarVariant, ...]:
    return tuple(NOMINAL._replace(**{name: factor}) for factor in factors)


def _vary_together(masses: Sequence[float], times: Sequence[float], friction: float) -> tuple[CarVariant, ...]:
    return tuple(CarVariant(mass, late, late, friction) for mass in masses for late in times)


POINTS: dict[str, tuple[CarVariant, ...]] = {
    "mass": _vary_one("mass", 0.9, 1.1, 1.2, 1.3),
    "lag": _vary_one("lag", 0.6, 0.8, 1.2, 1.4),
    "dead time": _vary_one("dead_time", 0.6, 0.8, 1.2, 1.4),
    "friction": _vary_one("friction", 0.9, 0.8, 0.7, 0.6),
    "steer gain": _vary_one("steer_gain", 0.6, 0.8, 1.2, 1.4),
    "together": _vary_together((0.9, 1.2), (0.8, 1.2), 0.8) + _vary_together((0.9, 1.3), (0.6, 1.4), 0.6),
}
DELAY, GAIN_UP, GAIN_DOWN = "delay", "gain_up", "gain_down"
SWEEPS: dict[str, tuple[CarVariant, ...]] = {
    DELAY: tuple(NOMINAL._replace(steer_delay_s=n / 100.0) for n in range(31)),
    GAIN_UP: tuple(NOMINAL._replace(steer_gain=n / 20.0) for n in range(20, 41)),
    GAIN_DOWN: tuple(NOMINAL._replace(steer_gain=n / 20.0) for n in range(20, 5, -1)),
}


def is_near_nominal(variant: CarVariant) -> bool:
    """Whether no factor is further than 20 % from 1, and no dead time is added."""
    limit = MAX_NEAR_NOMINAL + FACTOR_TOLERANCE
    return variant.steer_delay_s == 0.0 and all(abs(factor - 1.0) <= limit for factor in variant[:-1])


def describe_variant(variant: CarVariant) -> str:
    """Text such as 'mass +30 %, friction -40 %'."""
    parts = []
    for name in ("mass", "lag", "dead_time", "friction", "steer_gain"):
        factor = getattr(variant, name)
        if abs(factor - 1.0) > FACTOR_TOLERANCE:
            parts.append(f"{name.replace('_', ' ')} {100.0 * (factor - 1.0):+.0f} %")
    if variant.steer_delay_s:
        parts.append(f"{1e3 * variant.steer_delay_s:.0f} ms more steer dead time")
    return ", ".join(parts) or "as it is"


class MarginSearch:
    """Search for the first of several car variants, ordered by their distance from the model, that is not driven clean.

    `next_variant` is the one to drive next in all scenarios; at the end it is None, and `margin` is the result.
    """

    def __init__(self, variants: Sequence[CarVariant]) -> None:
        """variants: in this order; they differ in one field, and the first is the unchanged car."""
        changing = [i for i in range(len(NOMINAL)) if len({variant[i] for variant in variants}) > 1]
        if len(changing) != 1:
            raise ValueError(f"the variants must differ in exactly one field: {variants}")
        self._field = changing[0]
        self._variants = list(variants)
        self._index = 0
        self.margin: Margin | None = None

    @property
    def next_variant(self) -> CarVariant | None:
        return self._variants[self._index] if self.margin is None else None

    @property
    def remaining(self) -> int:
        """Largest number of variants still to be driven."""
        return len(self._variants) - self._index if self.margin is None else 0

    def record_outcomes(self, drives: Mapping[str, DriveOutcome]) -> None:
        """Record the drives of `next_variant` by scenario; the margin names the first scenario that is not clean."""
        value = self._variants[self._index][self._field]
        for scenario, drive in drives.items():
            if not drive.is_clean:
                self.margin = Margin(value, False, scenario, drive.outcome if drive.is_failed else "re-plan")
                return
        self._index += 1
        if self._index == len(self._variants):
            self.margin = Margin(value, True)


def failure_rate(drives: Iterable[DriveOutcome]) -> FailureRate:
    """Failure rate of some drives."""
    failed = [drive.is_failed for drive in drives]
    return FailureRate(sum(failed), len(failed))


def failure_rate_at_points(
    outcomes: Mapping[CarVariant, Mapping[str, DriveOutcome]], *, near_nominal: bool
) -> FailureRate:
    """Failure rate over the driven POINTS: those within +/-20 % of the model, or those beyond."""
    driven = [car for cars in POINTS.values() for car in cars if car in outcomes]
    cars = [car for car in driven if is_near_nominal(car) is near_nominal]
    return failure_rate(drive for car in cars for drive in outcomes[car].values())


def is_smaller_margin(margin: Margin, reference: Margin, *, down: bool = False) -> bool:
    """Whether `margin` is smaller than `reference`; down: for a gain that is lowered, the larger value is smaller."""
    sign = -1.0 if down else 1.0
    if abs(margin.value - reference.value) <= FACTOR_TOLERANCE:
        return reference.at_least and not margin.at_least
    return sign * margin.value < sign * reference.value


def steering_activity(commands: Iterable[NDArray[np.float64]], dt_s: float) -> SteeringActivity | None:
    """Activity over the steering commands [rad] of several drives; None without two finite samples in a drive."""
    squares = seconds = 0.0
    reversals = 0
    for command in commands:
        finite = command[np.isfinite(command)]
        if len(finite) < 2:
            continue
        rate = np.diff(finite) / dt_s
        squares += float(rate @ rate) * dt_s
        seconds += len(rate) * dt_s
        reversals += count_reversals(finite.tolist())
    return SteeringActivity(math.sqrt(squares / seconds), reversals / seconds) if seconds else None


def count_reversals(angles: Sequence[float], min_reversal_rad: float = MIN_REVERSAL_RAD) -> int:
    """Number of steering reversals (SAE J2944): changes of direction of at least `min_reversal_rad`."""
    low = high = extreme = angles[0]
    direction, count = 0, 0
    for angle in angles:
        if direction == 0:  # no movement of that size yet
            low, high = min(low, angle), max(high, angle)
            if high - low >= min_reversal_rad:
                direction, extreme = (1, high) if angle == high else (-1, low)
        elif direction * (angle - extreme) > 0.0:
            extreme = angle
        elif direction * (extreme - angle) >= min_reversal_rad:
            count += 1
            direction, extreme = -direction, angle
    return count
