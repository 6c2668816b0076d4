"""What a made road may ask of a vehicle: shares of its own limits, and the envelope of comfortable driving."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.roads.drive_ability import DriveAbility

GRAVITY_MPS2 = 9.81


class RoadCriteria(NamedTuple):
    """Limits of a made road. Between the two speeds of ISO 15622, 5 and 20 m/s, its values are linear in speed."""

    # m/s; faster is not tuned: the motorway speed of most countries is 30 to 36 m/s
    max_speed_mps: float = 30.0
    max_lateral_accel_mps2: float = 3.0  # m/s2 (ISO 11270; UN R79, ACSF)
    max_lateral_accel_share: float = 0.6  # of the vehicle's; the rest is left to the controller
    max_lateral_jerk_mps3: float = 5.0  # m/s3, mean over 0.5 s (ISO 11270; UN R79)
    max_accel_slow_mps2: float = 4.0  # m/s2, at 5 m/s and below (ISO 15622)
    max_accel_fast_mps2: float = 2.0  # m/s2, at 20 m/s and above (ISO 15622)
    max_decel_slow_mps2: float = 5.0  # m/s2, at 5 m/s and below (ISO 15622)
    max_decel_fast_mps2: float = 3.5  # m/s2, at 20 m/s and above (ISO 15622)
    max_jerk_slow_mps3: float = 5.0  # m/s3 along the road, mean over 0.5 s, at 5 m/s and below (ISO 15622)
    max_jerk_fast_mps3: float = 2.5  # m/s3 along the road, mean over 0.5 s, at 20 m/s and above (ISO 15622)
    max_longitudinal_share: float = 0.6  # of the vehicle's acceleration and deceleration, slope of the road included
    # m/s; above it the drive gives constant power: both vehicles' data sheets, with a half to spare at 30 m/s
    full_accel_speed_mps: float = 15.0
    max_steer_share: float = 0.85  # of the steering range, as in the shipped scenarios
    max_steer_rate_share: float = 0.7  # of the steering rate
    # s2/m; wheel angle over curvature grows by it times speed squared: measured on the reference car in steady turns
    min_understeer_s2pm: float = 0.004
    # of gravity times the road's friction, for the acceleration in the plane: dry asphalt gives 0.8 to 1.0
    max_grip_share: float = 0.5
    max_vertical_accel_mps2: float = 0.5  # m/s2, of crests and sags (comfort value of road design guides)
    min_duration_s: float = 15.0  # s; shorter ones end before an oscillation is seen
    max_duration_s: float = 30.0  # s; a set of 20 stays below ten minutes of driving
    design_share: float = 0.9  # of rates and jerks, at which a family designs its ramps
    jerk_window_s: float = 0.5  # s; moving average of both jerks (UN R79)


CRITERIA = RoadCriteria()


class RoadLimits(NamedTuple):
    """What a made road may ask of one vehicle; infinite where its folder does not say.

    Attributes:
        wheel_rad: Angle of the front wheels.
        wheel_rate_radps: Rate of the front wheels.
        wheelbase_m: Wheelbase; 1 where the wheel limits are unknown.
        understeer_s2pm: Growth of wheel angle over curvature with speed squared.
        decel_mps2: Deceleration, positive.
        drive: What the drive gives by speed; None where no map of it is known.
    """

    speed_mps: float
    wheel_rad: float
    wheel_rate_radps: float
    wheelbase_m: float
    understeer_s2pm: float
    lateral_accel_mps2: float
    accel_mps2: float
    decel_mps2: float
    drive: DriveAbility | None = None

    def curvature_1pm(self, speed_mps: float | np.ndarray) -> float | np.ndarray:
        """Greatest curvature at a speed: by the steering range, understeer included."""
        return math.tan(min(self.wheel_rad, 1.5)) / self._length_m(speed_mps)

    def curvature_rate_1pmps(self, speed_mps: float | np.ndarray) -> float | np.ndarray:
        """Greatest rate of curvature at a speed, 1/m per second."""
        return self.wheel_rate_radps / self._length_m(speed_mps)

    def lateral_at_mps2(self, speed_mps: float) -> float:
        """Greatest lateral acceleration at a speed: at low speed the steering range bounds it."""
        return min(self.lateral_accel_mps2, speed_mps * speed_mps * float(self.curvature_1pm(speed_mps)))

    def accel_at_mps2(self, speed_mps: float | np.ndarray) -> float | np.ndarray:
        """Greatest acceleration at a speed, the slope's share included."""
        powered = self.accel_mps2 * CRITERIA.full_accel_speed_mps / np.maximum(speed_mps, CRITERIA.full_accel_speed_mps)
        comfortable = by_iso_speed(speed_mps, CRITERIA.max_accel_slow_mps2, CRITERIA.max_accel_fast_mps2)
        given = np.inf if self.drive is None else self.drive.accel_at_mps2(speed_mps)
        return np.minimum(np.minimum(powered, comfortable), given)

    def decel_at_mps2(self, speed_mps: float | np.ndarray) -> float | np.ndarray:
        """Greatest deceleration at a speed, positive, the slope's share included."""
        comfortable = by_iso_speed(speed_mps, CRITERIA.max_decel_slow_mps2, CRITERIA.max_decel_fast_mps2)
        return np.minimum(self.decel_mps2, comfortable)

    def _length_m(self, speed_mps: float | np.ndarray) -> float | np.ndarray:
        return self.wheelbase_m + self.understeer_s2pm * speed_mps * speed_mps


def jerk_at_mps3(speed_mps: float | np.ndarray) -> float | np.ndarray:
    """Greatest jerk along the road at a speed."""
    return by_iso_speed(speed_mps, CRITERIA.max_jerk_slow_mps3, CRITERIA.max_jerk_fast_mps3)


def by_iso_speed(speed_mps: float | np.ndarray, slow: float, fast: float) -> float | np.ndarray:
    """A value of ISO 15622: `slow` to 5 m/s, `fast` from 20 m/s on, linear between."""
    share = np.clip((np.asarray(speed_mps, dtype=float) - 5.0) / 15.0, 0.0, 1.0)
    return slow + (fast - slow) * share


def road_limits(vehicle: VehicleSpec, drive: DriveAbility | None = None) -> RoadLimits:
    """The limits of the roads made for a vehicle, from its [limits] and [nominal] and what its drive gives."""
    limits, nominal = vehicle.limits, vehicle.nominal
    wheel_rad, wheel_rate_radps, wheelbase_m = math.inf, math.inf, 1.0
    if nominal.wheelbase_m and nominal.steer_ratio:
        wheelbase_m = nominal.wheelbase_m
        wheel_rad = CRITERIA.max_steer_share * limits.steer_rad / nominal.steer_ratio
        wheel_rate_radps = CRITERIA.max_steer_rate_share * limits.steer_rate_radps / nominal.steer_ratio
    share = CRITERIA.max_longitudinal_share
    return RoadLimits(
        speed_mps=min(limits.speed_mps, CRITERIA.max_speed_mps, math.inf if drive is None else drive.top_speed_mps()),
        wheel_rad=wheel_rad,
        wheel_rate_radps=wheel_rate_radps,
        wheelbase_m=wheelbase_m,
        understeer_s2pm=max(CRITERIA.min_understeer_s2pm, _understeer_s2pm(vehicle)),
        lateral_accel_mps2=min(
            CRITERIA.max_lateral_accel_mps2, CRITERIA.max_lateral_accel_share * limits.lateral_accel_mps2
        ),
        accel_mps2=share * max(limits.accel_mps2[1], 0.0),
        decel_mps2=share * max(-limits.accel_mps2[0], 0.0),
        drive=drive,
    )


def _understeer_s2pm(vehicle: VehicleSpec) -> float:
    """Of the single-track model of the data sheet: m / L (l_r / C_f - l_f / C_r); 0 where a constant is missing."""
    nominal = vehicle.nominal
    needed = (nominal.mass_kg, nominal.wheelbase_m, nominal.front_axle_m)
    stiffness = (nominal.front_stiffness_n_per_rad, nominal.rear_stiffness_n_per_rad)
    if not (all(needed) and all(stiffness)):
        return 0.0
    mass, wheelbase, front = (float(value or 0.0) for value in needed)
    front_stiffness, rear_stiffness = (float(value or 1.0) for value in stiffness)
    return mass / wheelbase * ((wheelbase - front) / front_stiffness - front / rear_stiffness)
