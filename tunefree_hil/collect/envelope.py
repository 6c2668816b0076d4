"""What a vehicle folder allows a collection to do, how much ground that takes, and how often a drive left it.

Curvatures are kinematic (steering through ratio and wheelbase of the data sheet): an understeering car does less.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import VehicleSpec

LATERAL_SHARE = 0.6  # of the vehicle's lateral acceleration that the planner plans with
RATE_SHARE = 0.9  # of its steering rate
BRAKE_SHARE = 0.5  # of its deceleration that stopping distances are planned with
HARD_SHARE = 0.7  # and the most that turning back brakes with
BUILD_UP_SHARE = 0.6  # of its acceleration that run-ups are planned with
SPEED_SHARE = 0.95
REACTION_S = 0.6  # from the wish to brake or steer to its effect: dead times, lags, the bus
TURN_MPS = 7.0  # the speed at which it turns back
LOCK_SHARE = 0.75  # of the steering angle that it turns back with
BORDER_M = 10.0  # kept free inside the area's border
WOBBLE_M = 3.0
DWELL_S = 2.0  # at the highest speed, on a straight run that is worth its run-up

Array = np.ndarray


class Envelope(NamedTuple):
    """Limits of vehicle.toml (pedals as duty), and what turns a steering-wheel angle into a curvature.

    throttle_most, brake_most: the greatest push, as share of the way from rest to the limit. calm_mps2: an acceleration
    above which the throttle is let go of, where a drive is to stay below one. high_share, low_share: what the two
    accelerations are of the vehicle's own, which say how much a pedal does.
    """

    speed_mps: float
    lateral_mps2: float
    steer_rad: float
    steer_rate_radps: float
    accel_low_mps2: float
    accel_high_mps2: float
    throttle_frac: float
    brake_frac: float
    rest_frac: float
    wheelbase_m: float
    steer_ratio: float
    throttle_most: float = 1.0
    brake_most: float = 1.0
    calm_mps2: float = math.inf
    high_share: float = 1.0
    low_share: float = 1.0


def envelope_of(vehicle: VehicleSpec) -> Envelope:
    """The envelope of a vehicle folder. Raises InputError where the data sheet lacks wheelbase or steering ratio."""
    limits, nominal = vehicle.limits, vehicle.nominal
    for name in ("wheelbase_m", "steer_ratio"):
        if getattr(nominal, name) is None:
            raise InputError(
                "the planner needs it to know how tightly the vehicle turns",
                code="missing_nominal",
                file=str(Path(vehicle.folder) / "vehicle.toml"),
                key=f"nominal.{name}",
                hint="add the data sheet's value; a rough one will do",
            )
    return Envelope(
        limits.speed_mps,
        limits.lateral_accel_mps2,
        limits.steer_rad,
        limits.steer_rate_radps,
        limits.accel_mps2[0],
        limits.accel_mps2[1],
        limits.throttle_frac,
        limits.brake_frac,
        nominal.rest_pedal_frac,
        float(nominal.wheelbase_m or 0.0),
        float(nominal.steer_ratio or 0.0),
    )


def curvature_1pm(envelope: Envelope, steer_rad: float) -> float:
    """Curvature of a slow drive at a steering-wheel angle."""
    road_wheel_rad = max(-1.4, min(1.4, steer_rad / envelope.steer_ratio))
    return math.tan(road_wheel_rad) / envelope.wheelbase_m


def steer_rad(envelope: Envelope, curvature: float) -> float:
    """The steering-wheel angle of a curvature."""
    return envelope.steer_ratio * math.atan(curvature * envelope.wheelbase_m)


def sharpest_1pm(envelope: Envelope, speed_mps: float) -> float:
    """The greatest curvature that the planner drives at a speed."""
    lock = curvature_1pm(envelope, LOCK_SHARE * envelope.steer_rad)
    square = speed_mps * speed_mps
    if square * lock <= LATERAL_SHARE * envelope.lateral_mps2:
        return lock
    return LATERAL_SHARE * envelope.lateral_mps2 / square


def turn_speed_mps(envelope: Envelope) -> float:
    """The speed at which it turns back: slow vehicles slower."""
    return min(TURN_MPS, 0.25 * envelope.speed_mps)


def turn_room_m(envelope: Envelope, speed_mps: float) -> float:
    """How far ahead a vehicle that begins to turn away at this speed still comes."""
    return 1.0 / sharpest_1pm(envelope, speed_mps) + REACTION_S * speed_mps + WOBBLE_M


def room_to_turn_m(envelope: Envelope, speed_mps: float) -> float:
    """Room ahead that a vehicle needs at this speed: react, brake to the turning speed, turn."""
    slow = min(speed_mps, turn_speed_mps(envelope))
    brake_mps2 = -BRAKE_SHARE * envelope.accel_low_mps2
    braking_m = 0.5 * (speed_mps * speed_mps - slow * slow) / brake_mps2
    return REACTION_S * speed_mps + braking_m + turn_room_m(envelope, slow)


def run_up_m(envelope: Envelope, from_mps: float, to_mps: float) -> float:
    """Length of a run-up as the planner reckons it."""
    gain = to_mps * to_mps - from_mps * from_mps
    return max(0.0, 0.5 * gain / (BUILD_UP_SHARE * envelope.accel_high_mps2))


def side_needed_m(envelope: Envelope, speed_mps: float) -> float:
    """Side of the square area in which this speed is reached, held for a moment and left again, along its diagonal."""
    slow = min(speed_mps, turn_speed_mps(envelope))
    straight_m = run_up_m(envelope, slow, speed_mps) + DWELL_S * speed_mps + room_to_turn_m(envelope, speed_mps)
    return (straight_m + 2.0 * turn_room_m(envelope, slow)) / math.sqrt(2.0) + 2.0 * BORDER_M


class Beyond(NamedTuple):
    """Seconds of a drive beyond the vehicle's envelope, and outside the area; NaN where nothing tells."""

    speed_s: float
    lateral_s: float
    steer_rate_s: float
    area_s: float

    @property
    def total_s(self) -> float:
        """The sum of what is known."""
        return sum(value for value in self if value == value)


def beyond(
    get: Callable[[str], Array | None], dt_s: float, envelope: Envelope, centre: tuple[float, float], area_m: float
) -> Beyond:
    """How long the recording whose fields `get` gives was beyond; lateral acceleration is speed x yaw rate.

    The steering rate is that of the command. Noise of the sensors counts as motion.
    """
    speed = _first(get, "report.speed_mps", "ins.speed_mps")
    yaw_rate = _first(get, "ins.yaw_rate_radps", "report.yaw_rate_radps")
    steer = _first(get, "command.steer_rad")
    x, y = get("ins.x_m"), get("ins.y_m")
    lateral = None if speed is None or yaw_rate is None else speed * yaw_rate
    rate = None if steer is None else np.diff(steer) / dt_s
    away = None if x is None or y is None else np.maximum(np.abs(x - centre[0]), np.abs(y - centre[1]))
    return Beyond(
        _seconds(speed, envelope.speed_mps, dt_s),
        _seconds(lateral, envelope.lateral_mps2, dt_s),
        _seconds(rate, envelope.steer_rate_radps * 1.02, dt_s),  # 2 %: the wire's rounding, at 10 ms
        _seconds(away, 0.5 * area_m, dt_s),
    )


def _first(get: Callable[[str], Array | None], *names: str) -> Array | None:
    return next((found for name in names if (found := get(name)) is not None), None)


def _seconds(values: Array | None, limit: float, dt_s: float) -> float:
    return math.nan if values is None else float(np.count_nonzero(np.abs(values) > limit)) * dt_s
