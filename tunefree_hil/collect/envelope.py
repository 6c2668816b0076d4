"""Driving envelope of a vehicle folder, the area that it needs, and how long a drive exceeded it.

Curvatures are kinematic (steering ratio and wheelbase of the data sheet); an understeering car reaches less.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import VehicleSpec

LATERAL_SHARE = 0.6  # share of the vehicle's lateral acceleration used for planning
RATE_SHARE = 0.9  # share of its steering rate
BRAKE_SHARE = 0.5  # share of its deceleration for stopping distances
HARD_SHARE = 0.7  # largest share of its deceleration when turning back
BUILD_UP_SHARE = 0.6  # share of its acceleration for run-ups
SPEED_SHARE = 0.95
REACTION_S = 0.6  # from a command to its effect: dead times, lags, the bus
TURN_MPS = 7.0  # speed when turning back
LOCK_SHARE = 0.75  # share of the steering angle when turning back
BORDER_M = 10.0  # free strip inside the border of the area
WOBBLE_M = 3.0  # allowance for path errors
DWELL_S = 2.0  # at the highest speed of a straight run

Array = np.ndarray


class Envelope(NamedTuple):
    """Limits of vehicle.toml (pedals as duty), and the constants from steering-wheel angle to curvature.

    max_throttle_push, max_brake_push: shares of the pedal travel from rest to the limit. throttle_release_mps2: the
    acceleration above which the throttle is reduced. accel_share, decel_share: the two acceleration limits as shares of
    the vehicle's own, which determine the effect of a pedal.
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
    max_throttle_push: float = 1.0
    max_brake_push: float = 1.0
    throttle_release_mps2: float = math.inf
    accel_share: float = 1.0
    decel_share: float = 1.0


def envelope_from_vehicle(vehicle: VehicleSpec) -> Envelope:
    """Envelope of a vehicle folder. Raises InputError where wheelbase or steering ratio is missing."""
    limits, nominal = vehicle.limits, vehicle.nominal
    for name in ("wheelbase_m", "steer_ratio"):
        if getattr(nominal, name) is None:
            raise InputError(
                "missing; the planner needs it to compute curvatures",
                code="missing_nominal",
                file=str(Path(vehicle.folder) / "vehicle.toml"),
                key=f"nominal.{name}",
                hint="add the data sheet's value; an approximate one is sufficient",
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
    """Curvature at a steering-wheel angle at low speed."""
    road_wheel_rad = max(-1.4, min(1.4, steer_rad / envelope.steer_ratio))
    return math.tan(road_wheel_rad) / envelope.wheelbase_m


def steer_for_curvature_rad(envelope: Envelope, curvature: float) -> float:
    """Steering-wheel angle for a curvature."""
    return envelope.steer_ratio * math.atan(curvature * envelope.wheelbase_m)


def max_curvature_1pm(envelope: Envelope, speed_mps: float) -> float:
    """Largest planned curvature at a speed."""
    lock = curvature_1pm(envelope, LOCK_SHARE * envelope.steer_rad)
    square = speed_mps * speed_mps
    if square * lock <= LATERAL_SHARE * envelope.lateral_mps2:
        return lock
    return LATERAL_SHARE * envelope.lateral_mps2 / square


def turning_speed_mps(envelope: Envelope) -> float:
    """Speed when turning back; lower for slow vehicles."""
    return min(TURN_MPS, 0.25 * envelope.speed_mps)


def turn_advance_m(envelope: Envelope, speed_mps: float) -> float:
    """Distance that a vehicle still moves ahead when it begins to turn away at this speed."""
    return 1.0 / max_curvature_1pm(envelope, speed_mps) + REACTION_S * speed_mps + WOBBLE_M


def turn_back_room_m(envelope: Envelope, speed_mps: float) -> float:
    """Free distance needed ahead at this speed: react, brake to the turning speed, turn."""
    slow_mps = min(speed_mps, turning_speed_mps(envelope))
    brake_mps2 = -BRAKE_SHARE * envelope.accel_low_mps2
    braking_m = 0.5 * (speed_mps * speed_mps - slow_mps * slow_mps) / brake_mps2
    return REACTION_S * speed_mps + braking_m + turn_advance_m(envelope, slow_mps)


def run_up_m(envelope: Envelope, from_mps: float, to_mps: float) -> float:
    """Planned length of a run-up."""
    gain = to_mps * to_mps - from_mps * from_mps
    return max(0.0, 0.5 * gain / (BUILD_UP_SHARE * envelope.accel_high_mps2))


def area_side_for_speed_m(envelope: Envelope, speed_mps: float) -> float:
    """Side of the square area in which this speed can be reached and held for DWELL_S along the diagonal."""
    slow = min(speed_mps, turning_speed_mps(envelope))
    straight_m = run_up_m(envelope, slow, speed_mps) + DWELL_S * speed_mps + turn_back_room_m(envelope, speed_mps)
    return (straight_m + 2.0 * turn_advance_m(envelope, slow)) / math.sqrt(2.0) + 2.0 * BORDER_M


class EnvelopeExcess(NamedTuple):
    """Seconds of a drive beyond the vehicle's envelope, and outside the area; NaN where not known."""

    speed_s: float
    lateral_s: float
    steer_rate_s: float
    area_s: float

    @property
    def total_s(self) -> float:
        """Sum of the known values."""
        return sum(value for value in self if value == value)


def measure_excess(
    get: Callable[[str], Array | None], dt_s: float, envelope: Envelope, centre: tuple[float, float], area_m: float
) -> EnvelopeExcess:
    """Time of a recording beyond the envelope; get: its columns by name.

    Lateral acceleration is speed * yaw rate, the steering rate that of the command. Sensor noise counts as motion.
    """
    speed = _first_available(get, "report.speed_mps", "ins.speed_mps")
    yaw_rate = _first_available(get, "ins.yaw_rate_radps", "report.yaw_rate_radps")
    steer = _first_available(get, "command.steer_rad")
    x, y = get("ins.x_m"), get("ins.y_m")
    lateral = None if speed is None or yaw_rate is None else speed * yaw_rate
    rate = None if steer is None else np.diff(steer) / dt_s
    away = None if x is None or y is None else np.maximum(np.abs(x - centre[0]), np.abs(y - centre[1]))
    return EnvelopeExcess(
        _seconds_above(speed, envelope.speed_mps, dt_s),
        _seconds_above(lateral, envelope.lateral_mps2, dt_s),
        _seconds_above(rate, envelope.steer_rate_radps * 1.02, dt_s),  # 2 %: the wire's rounding, at 10 ms
        _seconds_above(away, 0.5 * area_m, dt_s),
    )


def _first_available(get: Callable[[str], Array | None], *names: str) -> Array | None:
    return next((values for name in names if (values := get(name)) is not None), None)


def _seconds_above(values: Array | None, limit: float, dt_s: float) -> float:
    return math.nan if values is None else float(np.count_nonzero(np.abs(values) > limit)) * dt_s
