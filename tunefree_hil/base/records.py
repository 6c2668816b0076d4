"""The records of the control loop, in the order of the signal flow.

Units are in the names, SI. Axes ISO 8855: x forward, y left; yaw, steer and curvature positive to the left.
`steer_rad` is the steering *wheel* angle, `road_wheel_rad` that of the road wheels. Pedal fractions are duty as on
the wire (MKZ: 0.15 at rest). A value that a vehicle does not have is NaN; these fields are known when a bench is built
(`VehicleSpec.absent`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

NAN = math.nan

# Gear codes inside the project; the vehicle folder's `scale` maps the codes on the wire.
GEAR_NONE, GEAR_PARK, GEAR_REVERSE, GEAR_NEUTRAL, GEAR_DRIVE, GEAR_LOW = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0


class Command(NamedTuple):
    """Command of the controller to the vehicle; the fields of `[command.*]` in vehicle.toml, in this order."""

    throttle_frac: float = NAN
    brake_frac: float = NAN
    steer_rad: float = NAN
    gear: float = NAN
    accel_mps2: float = NAN
    steer_torque_nm: float = NAN


class Disturbance(NamedTuple):
    """The road at this tick; read from the scenario before tick 0."""

    grade_rad: float = 0.0  # up positive
    friction_frac: float = 1.0
    bank_rad: float = 0.0  # left side up positive: gravity pulls to the right
    side_wind_mps2: float = 0.0  # force of the wind over the vehicle's mass, to the left


class Actuation(NamedTuple):
    """Output of the by-wire actuators, input of the plant."""

    throttle_frac: float
    brake_frac: float
    steer_rad: float
    gear: float


class Motion(NamedTuple):
    """True motion of the vehicle: pose of the rear axle centre, velocities and specific force at the centre of mass.

    accel_mps2, lateral_accel_mps2 are specific force as an accelerometer measures it (gravity included);
    speed_rate_mps2 is the rate of the forward speed.
    """

    x_m: float
    y_m: float
    heading_rad: float
    speed_mps: float  # forward, at the rear axle
    side_speed_mps: float  # to the left, at the centre of mass
    yaw_rate_radps: float
    accel_mps2: float
    lateral_accel_mps2: float
    speed_rate_mps2: float
    wheel_fl_radps: float
    wheel_fr_radps: float
    wheel_rl_radps: float
    wheel_rr_radps: float


class Report(NamedTuple):
    """Content of the chassis frames; the fields of `[report.*]`, in this order (wheel_speed_radps is four fields)."""

    throttle_input_frac: float = NAN
    throttle_command_frac: float = NAN
    throttle_frac: float = NAN
    brake_input_frac: float = NAN
    brake_command_frac: float = NAN
    brake_frac: float = NAN
    steer_command_rad: float = NAN
    steer_rad: float = NAN
    speed_mps: float = NAN
    wheel_fl_radps: float = NAN
    wheel_fr_radps: float = NAN
    wheel_rl_radps: float = NAN
    wheel_rr_radps: float = NAN
    accel_mps2: float = NAN
    lateral_accel_mps2: float = NAN
    yaw_rate_radps: float = NAN
    gear: float = NAN
    accel_command_mps2: float = NAN
    steer_torque_command_nm: float = NAN
    steer_torque_nm: float = NAN


class Ins(NamedTuple):
    """Content of the INS frames; the fields of `[ins.*]`, in this order. Point and frame: `[ins_frame]`."""

    x_m: float = NAN
    y_m: float = NAN
    heading_rad: float = NAN
    speed_mps: float = NAN
    accel_mps2: float = NAN
    yaw_rate_radps: float = NAN


class Measurement(NamedTuple):
    """Measurements for the controller: chassis reports and INS."""

    report: Report
    ins: Ins


GROUPS: dict[str, Any] = {"command": Command, "report": Report, "ins": Ins}
WHEEL_FIELDS = ("wheel_fl_radps", "wheel_fr_radps", "wheel_rl_radps", "wheel_rr_radps")


class CanFrame(NamedTuple):
    """One raw frame. `time_s` is the bus's time stamp (virtual time in lockstep)."""

    id: int
    data: bytes
    extended: bool = False
    fd: bool = False
    time_s: float = 0.0
