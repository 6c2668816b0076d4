"""Coverage cells: gear x steering band x speed band x pedal band (apollo_facts 5.1), scaled by the vehicle folder.

The source's bands in shares of the MKZ's limits: speeds 10 and 20 m/s of 40, pedals of the way from rest to the limit,
steering 1, 30 and 60 % of the wheel. So they mean the same on a van and on a kart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from tunefree_hil.base.records import GEAR_NEUTRAL, GEAR_PARK, GEAR_REVERSE
from tunefree_hil.collect.envelope import LATERAL_SHARE, SPEED_SHARE, Envelope, curvature_1pm

STEERS = ("sharp right", "turn right", "branch right", "straight", "branch left", "turn left", "sharp left")
STRAIGHT = 3
PEDALS = ("brake high", "brake mid", "brake light", "throttle light", "throttle mid", "throttle high")
FIRST_THROTTLE = 3
SPEEDS = 3
STEER_EDGES = (0.01, 0.30, 0.60)  # of the steering limit
SPEED_EDGES = (0.25, 0.50)  # of the speed limit
THROTTLE_EDGES = (0.01, 0.154, 0.231)  # of the way from rest to the limit; below the first the pedal counts as at rest
BRAKE_EDGES = (0.01, 0.143, 0.286)
LEAST_MPS = 0.2
REVERSE_MPS = 2.0  # backwards there is one speed band, up to here
LEAST_RUN = 20  # frames in a row that count
FORWARD = len(STEERS) * SPEEDS * len(PEDALS)
COUNT = FORWARD + len(STEERS) * len(PEDALS)
NONE = -1
WINDOW = 1.25  # how far into the open speed band the planner goes
LEAST_WINDOW = 1.1  # upper over lower speed of a cell, below which it is not worth going for


class Seen(NamedTuple):
    """What cells are told by at one tick. gear NaN: nobody says, so it is taken to be drive."""

    gear: float
    speed_mps: float
    steer_rad: float
    throttle_frac: float
    brake_frac: float


class Place(NamedTuple):
    """A cell in words of numbers: index of steering band, speed band (0 when backwards), pedal band."""

    backwards: bool
    steer: int
    speed: int
    pedal: int


class Target(NamedTuple):
    """A cell to fill: the speeds at which the planner drives it. excluded: why it is not asked for, or ''."""

    place: Place
    low_mps: float
    high_mps: float
    excluded: str


class Bands(NamedTuple):
    """Edges of the cells of one vehicle. Pedal edges are duty as on the wire, steering edges steering-wheel rad."""

    speed_mps: tuple[float, float, float]
    steer_rad: tuple[float, float, float]
    throttle_frac: tuple[float, float, float]
    brake_frac: tuple[float, float, float]


def bands_of(envelope: Envelope) -> Bands:
    """The bands of a vehicle."""
    rest = envelope.rest_frac
    throttle, brake = envelope.throttle_frac - rest, envelope.brake_frac - rest
    first, second = SPEED_EDGES
    a, b, c = STEER_EDGES
    t, u, v = THROTTLE_EDGES
    d, e, f = BRAKE_EDGES
    return Bands(
        (LEAST_MPS, first * envelope.speed_mps, second * envelope.speed_mps),
        (a * envelope.steer_rad, b * envelope.steer_rad, c * envelope.steer_rad),
        (rest + t * throttle, rest + u * throttle, rest + v * throttle),
        (rest + d * brake, rest + e * brake, rest + f * brake),
    )


def number_of(place: Place) -> int:
    """The cell's number, 0 to COUNT - 1."""
    if place.backwards:
        return FORWARD + place.steer * len(PEDALS) + place.pedal
    return (place.steer * SPEEDS + place.speed) * len(PEDALS) + place.pedal


def place_of(number: int) -> Place:
    """The inverse of `number_of`."""
    if number >= FORWARD:
        steer, pedal = divmod(number - FORWARD, len(PEDALS))
        return Place(True, steer, 0, pedal)
    rest, pedal = divmod(number, len(PEDALS))
    steer, speed = divmod(rest, SPEEDS)
    return Place(False, steer, speed, pedal)


def cell_of(bands: Bands, seen: Seen) -> int:
    """The number of the cell that a tick belongs to; NONE at standstill, with no pedal pressed, or where a value lacks.

    The brake wins where both pedals are pressed.
    """
    speed = abs(seen.speed_mps)
    total = speed + seen.steer_rad + seen.throttle_frac + seen.brake_frac
    if total - total != 0.0 or speed < bands.speed_mps[0] or seen.gear in (GEAR_PARK, GEAR_NEUTRAL):
        return NONE
    pressed = _above(bands.brake_frac, seen.brake_frac)
    if pressed:
        pedal = FIRST_THROTTLE - pressed
    else:
        pressed = _above(bands.throttle_frac, seen.throttle_frac)
        if not pressed:
            return NONE
        pedal = FIRST_THROTTLE - 1 + pressed
    turn = _above(bands.steer_rad, abs(seen.steer_rad))
    steer = STRAIGHT + turn if seen.steer_rad > 0.0 else STRAIGHT - turn
    if seen.gear == GEAR_REVERSE:
        return number_of(Place(True, steer, 0, pedal)) if speed < REVERSE_MPS else NONE
    return number_of(Place(False, steer, _above(bands.speed_mps, speed) - 1, pedal))


def _above(edges: tuple[float, float, float], value: float) -> int:
    return (value >= edges[0]) + (value >= edges[1]) + (value >= edges[2])


def targets_of(envelope: Envelope, top_mps: float | None = None, *, reverse_mps: float = 0.0) -> tuple[Target, ...]:
    """Every cell by its number: how fast to drive it, or why it is left out.

    top_mps: the fastest that may be asked for. reverse_mps: how fast the vehicle drives backwards, 0 where it does not.
    """
    return tuple(_target(envelope, place_of(number), top_mps, reverse_mps) for number in range(COUNT))


def fastest_mps(envelope: Envelope, top_mps: float | None = None) -> float:
    """The highest speed that is planned."""
    most = min(SPEED_SHARE * envelope.speed_mps, WINDOW * SPEED_EDGES[1] * envelope.speed_mps)
    return most if top_mps is None else min(most, top_mps)


def _target(envelope: Envelope, place: Place, top_mps: float | None, reverse_mps: float) -> Target:
    bands, top = bands_of(envelope), fastest_mps(envelope, top_mps)
    low = bands.speed_mps[place.speed]
    high = min([*bands.speed_mps[1:], math.inf][place.speed], top)
    if place.backwards:
        why = "" if reverse_mps > LEAST_MPS else "the folder does not say that it drives backwards (limits.reverse_mps)"
        return Target(place, LEAST_MPS, min(reverse_mps, REVERSE_MPS), why)
    if high < LEAST_WINDOW * low:
        return Target(place, low, high, f"from {low:.3g} m/s on; at most {top:.3g} m/s are asked for")
    turn = abs(place.steer - STRAIGHT)
    if turn == 0:
        return Target(place, low, high, "")
    angle = 1.15 * bands.steer_rad[turn - 1]
    bound_mps2 = LATERAL_SHARE * envelope.lateral_mps2
    bent = math.sqrt(bound_mps2 / curvature_1pm(envelope, angle))
    if bent < LEAST_WINDOW * low:
        felt = low * low * curvature_1pm(envelope, angle)
        why = f"{100.0 * STEER_EDGES[turn - 1]:.0f} % of the wheel at {low:.3g} m/s is {felt:.1f} m/s2 sideways, "
        return Target(place, low, bent, why + f"at most {bound_mps2:.1f} are planned")
    return Target(place, low, min(high, bent), "")


class Counter:
    """Counts frames by cell, tick by tick: only runs of at least LEAST_RUN in one cell count, and then whole."""

    def __init__(self, need: Sequence[int], have: Sequence[int] | None = None) -> None:
        self.need = list(need)
        self.have = list(have) if have is not None else [0] * len(self.need)
        self.missing = sum(have < need for have, need in zip(self.have, self.need, strict=True))
        self._cell, self._run = NONE, 0

    def see(self, cell: int) -> None:
        """One tick that belongs to `cell`, or to NONE."""
        if cell != self._cell:
            self._cell, self._run = cell, 0
        self._run += 1
        if cell == NONE or self._run < LEAST_RUN:
            return
        before = self.have[cell]
        self.have[cell] = before + (LEAST_RUN if self._run == LEAST_RUN else 1)
        if before < self.need[cell] <= self.have[cell]:
            self.missing -= 1

    def pause(self) -> None:
        """A gap: what comes next begins a new run."""
        self._cell, self._run = NONE, 0

    def lacks(self, cell: int) -> bool:
        """Whether a cell is asked for and not full."""
        return self.have[cell] < self.need[cell]


def needs_of(targets: Sequence[Target], quota_s: float, dt_s: float) -> list[int]:
    """Frames asked for by cell, 0 where a cell is left out."""
    quota = max(1, round(quota_s / dt_s))
    return [0 if target.excluded else quota for target in targets]
