"""How much a car may differ before it is driven badly: margins, failure rates and nervous steering, from outcomes.

Pure functions: which cars there are (`Car`), in which order they are tried (`Walk`), and what the outcomes say. A
drive *fails* where it is not driven to its end (|lateral error| > the lane's half width, 2 m, or divergence); it is
*calm* where it neither fails nor re-plans. A margin is the first value at which a drive is not calm: 0 is none.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.grade.score import FINISHED

INSIDE = 0.2  # 0 failures are wanted where no factor is further from 1
NEAR = 1e-9  # of factors that were meant to be equal
REVERSAL_GAP_RAD = math.radians(1.0)  # of the steering wheel; ten steps of a by-wire command's usual quantisation


class Car(NamedTuple):
    """A car that differs from its model by factors, and by an extra steer dead time in seconds.

    lag, dead_time: of all actuators. friction: between tyre and road. steer_gain: of the steering behind its report.
    """

    mass: float = 1.0
    lag: float = 1.0
    dead_time: float = 1.0
    friction: float = 1.0
    steer_gain: float = 1.0
    steer_delay_s: float = 0.0


class Came(NamedTuple):
    """What came out of a drive: 'finished' or what ended it, and its re-plans."""

    outcome: str
    replans: int

    @property
    def failed(self) -> bool:
        return self.outcome != FINISHED

    @property
    def calm(self) -> bool:
        return not self.failed and self.replans == 0


class Margin(NamedTuple):
    """The first value at which a drive was not calm, in which scenario, and what it did.

    at_least: none was found up to `value`, where the search ends; scenario and what are then ''.
    """

    value: float
    at_least: bool = False
    scenario: str = ""
    what: str = ""


class Rate(NamedTuple):
    """Failed drives of so many."""

    failed: int
    drives: int

    @property
    def share(self) -> float:
        return self.failed / self.drives if self.drives else math.nan


class Steering(NamedTuple):
    """How nervous the steering command is: RMS of its rate at the steering wheel, and reversals a second."""

    rate_rms_radps: float
    reversals_per_s: float


SAME = Car()


def _one(name: str, *factors: float) -> tuple[Car, ...]:
    return tuple(SAME._replace(**{name: factor}) for factor in factors)


def _together(masses: Sequence[float], times: Sequence[float], friction: float) -> tuple[Car, ...]:
    return tuple(Car(mass, late, late, friction) for mass in masses for late in times)


POINTS: dict[str, tuple[Car, ...]] = {
    "mass": _one("mass", 0.9, 1.1, 1.2, 1.3),
    "lag": _one("lag", 0.6, 0.8, 1.2, 1.4),
    "dead time": _one("dead_time", 0.6, 0.8, 1.2, 1.4),
    "friction": _one("friction", 0.9, 0.8, 0.7, 0.6),
    "steer gain": _one("steer_gain", 0.6, 0.8, 1.2, 1.4),
    "together": _together((0.9, 1.2), (0.8, 1.2), 0.8) + _together((0.9, 1.3), (0.6, 1.4), 0.6),
}
DELAY, GAIN_UP, GAIN_DOWN = "delay", "gain_up", "gain_down"
WALKS: dict[str, tuple[Car, ...]] = {
    DELAY: tuple(SAME._replace(steer_delay_s=n / 100.0) for n in range(31)),
    GAIN_UP: tuple(SAME._replace(steer_gain=n / 20.0) for n in range(20, 41)),
    GAIN_DOWN: tuple(SAME._replace(steer_gain=n / 20.0) for n in range(20, 5, -1)),
}


def is_inside(car: Car) -> bool:
    """Whether no factor is further than 20 % from 1, and no dead time is added."""
    return car.steer_delay_s == 0.0 and all(abs(factor - 1.0) <= INSIDE + NEAR for factor in car[:-1])


def said(car: Car) -> str:
    """'mass +30 %, friction -40 %'."""
    words = {"mass": "mass", "lag": "lag", "dead_time": "dead time", "friction": "friction", "steer_gain": "steer gain"}
    parts = [f"{word} {100.0 * (factor - 1.0):+.0f} %" for name, word in words.items()
             if abs((factor := getattr(car, name)) - 1.0) > NEAR]  # fmt: skip
    if car.steer_delay_s:
        parts.append(f"{1e3 * car.steer_delay_s:.0f} ms more steer dead time")
    return ", ".join(parts) or "as it is"


class Walk:
    """Cars further and further from what the model is, until a drive is not calm: that value counts, whatever drives
    behind it would do. `ahead` is the next car to drive in all scenarios, None at the end; `found` is then the margin.
    """

    def __init__(self, cars: Sequence[Car]) -> None:
        """cars: in this order; they differ in one field, and the first is the car as it is."""
        changing = [i for i in range(len(SAME)) if len({car[i] for car in cars}) > 1]
        if len(changing) != 1:
            raise ValueError(f"these cars do not differ in one field: {cars}")
        self._field = changing[0]
        self._cars = list(cars)
        self._at = 0
        self.found: Margin | None = None

    @property
    def ahead(self) -> Car | None:
        return self._cars[self._at] if self.found is None else None

    @property
    def left(self) -> int:
        """Cars that may still have to be driven."""
        return len(self._cars) - self._at if self.found is None else 0

    def tell(self, drives: Mapping[str, Came]) -> None:
        """What came out of the car ahead, by scenario; the first scenario that is not calm is named."""
        value = self._cars[self._at][self._field]
        for scenario, came in drives.items():
            if not came.calm:
                self.found = Margin(value, False, scenario, came.outcome if came.failed else "re-plan")
                return
        self._at += 1
        if self._at == len(self._cars):
            self.found = Margin(value, True)


def rate_of(drives: Iterable[Came]) -> Rate:
    """How many failed."""
    failed = [came.failed for came in drives]
    return Rate(sum(failed), len(failed))


def rates(driven: Mapping[Car, Mapping[str, Came]], *, inside: bool) -> Rate:
    """Failures over all of POINTS that were driven and are within +/-20 %, or those beyond."""
    cars = [car for cars in POINTS.values() for car in cars if car in driven and is_inside(car) is inside]
    return rate_of(came for car in cars for came in driven[car].values())


def is_less(margin: Margin, other: Margin, *, down: bool = False) -> bool:
    """Whether `margin` is the smaller one; down: of a gain that is lowered, where the larger value is the less."""
    way = -1.0 if down else 1.0
    if abs(margin.value - other.value) <= NEAR:
        return other.at_least and not margin.at_least
    return way * margin.value < way * other.value


def steering_of(commands: Iterable[NDArray[np.float64]], dt_s: float) -> Steering | None:
    """Over the steering commands [rad] of some drives together; None where there is not one finite pair of samples."""
    squares = seconds = 0.0
    reversals = 0
    for command in commands:
        finite = command[np.isfinite(command)]
        if len(finite) < 2:
            continue
        rate = np.diff(finite) / dt_s
        squares += float(rate @ rate) * dt_s
        seconds += len(rate) * dt_s
        reversals += reversals_of(finite.tolist())
    return Steering(math.sqrt(squares / seconds), reversals / seconds) if seconds else None


def reversals_of(angles: Sequence[float], gap_rad: float = REVERSAL_GAP_RAD) -> int:
    """Changes of direction of at least `gap_rad` (SAE J2944's steering reversals: smaller to and fro is not counted).

    A reversal is where the wheel, having moved one way by the gap or more, has come back by the gap or more.
    """
    low = high = extreme = angles[0]
    way, found = 0, 0
    for angle in angles:
        if way == 0:  # not moved by the gap yet
            low, high = min(low, angle), max(high, angle)
            if high - low >= gap_rad:
                way, extreme = (1, high) if angle == high else (-1, low)
        elif way * (angle - extreme) > 0.0:
            extreme = angle
        elif way * (extreme - angle) >= gap_rad:
            found += 1
            way, extreme = -way, angle
    return found
