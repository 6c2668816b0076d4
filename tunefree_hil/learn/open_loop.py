"""The open-loop map of a model, made by driving it with held pedals: triples (speed, acceleration, command).

For each speed and pedal duty the model is put on a level, straight road at that speed and the rate of its speed is
read off, thinned to where a command makes a difference. Standstill itself is left out: there a brake shows nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.open_loop_map import KEYS
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.plant.actuators import ActuatorParams, shaped
from tunefree_hil.plant.body import Plant
from tunefree_hil.plant.vehicle import steady_accel

SPEEDS_MPS = (0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)
SPEEDS_MPS += (12.0, 14.0, 16.0, 18.0, 20.0, 22.5, 25.0, 27.5, 30.0)
FINE_STEPS = 16  # of duty 0.005 from rest, where the pedals begin to bite
FINE_FRAC, COARSE_FRAC = 0.005, 0.02
LEAST_STEP_MPS2 = 0.005  # points closer than this say the same

Triple = tuple[float, float, float]
AccelOf = Callable[[float, float, float], float]  # (speed, throttle duty, brake duty) -> m/s2


class Pedal(NamedTuple):
    """Duty at rest and the most that the vehicle takes."""

    rest_frac: float
    limit_frac: float

    def duties(self) -> list[float]:
        """From rest to the limit: fine steps first."""
        fine = [self.rest_frac + FINE_FRAC * i for i in range(FINE_STEPS)]
        start = fine[-1] + COARSE_FRAC
        coarse = [start + COARSE_FRAC * i for i in range(round((self.limit_frac - start) / COARSE_FRAC))]
        return [duty for duty in fine + coarse if duty < self.limit_frac - 1e-9] + [self.limit_frac]


def sweep(accel_of: AccelOf, throttle: Pedal, brake: Pedal, speeds: Sequence[float] = SPEEDS_MPS) -> list[Triple]:
    """The triples, by speed and then by acceleration; brake commands are negative.

    Between the last brake duty that does nothing and the last throttle duty that does nothing the acceleration is that
    of coasting; the map has both, a hair apart, so that neither pedal's dead band is interpolated away.
    """
    triples = []
    for speed in speeds:
        braking = _biting([(accel_of(speed, throttle.rest_frac, duty), -duty) for duty in brake.duties()], -1.0)
        pushing = _biting([(accel_of(speed, duty, brake.rest_frac), duty) for duty in throttle.duties()], 1.0)
        coasting = braking[0][0]
        braking[0] = (coasting - 0.5 * LEAST_STEP_MPS2, braking[0][1])
        triples += [(speed, accel, command) for accel, command in reversed(braking)]
        triples += [(speed, accel, command) for accel, command in pushing]
    return triples


def _biting(points: list[tuple[float, float]], sign: float) -> list[tuple[float, float]]:
    """(acceleration, command) points from the last that does as little as the first, each LEAST_STEP further."""
    first = points[0][0]
    idle = [point for point in points if sign * (point[0] - first) < LEAST_STEP_MPS2]
    kept = [(first, idle[-1][1])]
    for accel, command in points:
        if sign * (accel - kept[-1][0]) >= LEAST_STEP_MPS2:
            kept.append((accel, command))
    return kept


def open_loop_map(
    plant: Plant,
    params: Mapping[str, float],
    vehicle: VehicleSpec,
    actuators: Mapping[str, ActuatorParams] | None = None,
) -> list[Triple]:
    """The triples of a plant whose steady acceleration needs no settling.

    actuators: 'throttle', 'brake'; the map's commands are then theirs, through dead band, gain and offset. None: the
    commands are what the plant feels.
    """
    channels = actuators or {}

    def felt(channel: str, duty: float) -> float:
        return float(shaped(channels[channel], duty)) if channel in channels else duty

    def accel_of(speed_mps: float, throttle_frac: float, brake_frac: float) -> float:
        pedals = felt("throttle", throttle_frac), felt("brake", brake_frac)
        return steady_accel(plant, params, speed_mps, *pedals)

    rest_frac = vehicle.nominal.rest_pedal_frac
    return sweep(accel_of, Pedal(rest_frac, vehicle.limits.throttle_frac), Pedal(rest_frac, vehicle.limits.brake_frac))


def as_arrays(triples: Sequence[Triple]) -> dict[str, np.ndarray]:
    """The arrays of calibration.npz."""
    return dict(zip(KEYS, np.array(triples, dtype=np.float64).T, strict=True))
