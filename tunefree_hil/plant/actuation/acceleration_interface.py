"""A car with an acceleration command: its own controller operates engine and brakes; the pedals are not on the bus.

The output of `[actuators.accel]` is converted to two pedals whose full duty is FULL_MPS2 in each direction. With
`LINEAR` as [plant.params] the chassis converts them back to that acceleration and adds slope, cornering and friction.
Every plant and every learned residual therefore works as on a car with pedals.
"""

from __future__ import annotations

from typing import Any

from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.records import Actuation, Command
from tunefree_hil.plant.actuation.actuators import ActuatorParams, init_actuator, step_actuator

FULL_MPS2 = 10.0  # above the acceleration and the braking of any road car
_NEVER = 1.0e3  # knee of the drive in full duties, and its power in FULL_MPS2 * m/s: both out of reach


def linear(mass_kg: float, rest_frac: float) -> dict[str, float]:
    """[plant.params] with which a chassis converts these pedals to acceleration, without resistance of its own."""
    full_n = FULL_MPS2 * mass_kg
    return {
        "rest_pedal_frac": rest_frac,
        "throttle_zero_frac": rest_frac,
        "throttle_full_frac": rest_frac + 1.0,
        "drive_force_n": full_n * _NEVER,
        "drive_knee_frac": _NEVER,
        "drive_power_w": full_n * _NEVER * 1.0e3,
        "drive_corner": 2.0,
        "creep_force_n": 0.0,
        "creep_speed_mps": 1.0,
        "overrun_force_n": 0.0,
        "brake_force_n_per_frac": full_n,
        "brake_rise_per_frac": 0.0,
        "rolling_frac": 0.0,
        "drag_area_m2": 0.0,
    }


@kernel
def pedals_of(accel_mps2: float, rest_frac: float) -> tuple[float, float]:
    """(throttle, brake) duty for an acceleration."""
    share = accel_mps2 / FULL_MPS2
    if share > 0.0:
        return rest_frac + share, rest_frac
    return rest_frac, rest_frac - share


def actuators_by_accel(accel: ActuatorParams, steer: ActuatorParams, rest_frac: float) -> Block:
    """The channels of such a car as a Block Command -> Actuation; the gear changes without delay."""

    def init(params: Any, dt_s: float) -> Any:
        return (init_actuator(params[0], dt_s), init_actuator(params[1], dt_s))

    @kernel
    def step(params: Any, state: Any, x: Command, dt_s: float) -> tuple[Any, Actuation]:
        accel_state, accel_mps2 = step_actuator(params[0], state[0], x.accel_mps2, dt_s)
        steer_state, steer_rad = step_actuator(params[1], state[1], x.steer_rad, dt_s)
        throttle_frac, brake_frac = pedals_of(accel_mps2, params[2])
        return (accel_state, steer_state), Actuation(throttle_frac, brake_frac, steer_rad, x.gear)

    return Block(init, step, (accel, steer, rest_frac))
