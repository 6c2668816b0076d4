"""A driver model that steers: anticipation by the road ahead, delayed compensation of the error, smooth arms.

Two levels as in Donges, "A two-level model of driver steering behavior", Human Factors 20 (1978) 691-707
(doi:10.1177/001872087802000607): open-loop steering for the curvature that is seen ahead, and closed-loop correction
of the lateral error after a reaction time. The correction is a damped return to the path with a bandwidth that does not
depend on the speed. It is a model, not a recorded person.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block, Tunable
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import buffer, kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import NAN, Measurement
from tunefree_hil.control.contract import Recipe, Setup, chassis_speed_of, speed_of
from tunefree_hil.control.steering_map import SteeringMap, steady_road_wheel_rad, wheel_rad

SPEED_FLOOR_MPS = 3.0  # the correction does not grow below it: nobody turns the wheel to the stop for a few centimetres
LAG_FLOOR_MPS = 1.0
CORRECTION_MPS2 = 1.5  # largest lateral acceleration of the correction; anticipation has no such bound
# Within a second the heading says how fast the vehicle leaves the path, beyond it the lateral error does: the side-slip
# of steady cornering is known only roughly, and would be an offset of metres at 20 m/s.
OBSERVER_RADPS = 1.0
CHASSIS_LAG_S = 0.15  # from the road wheels to the yaw rate, passenger cars at 10 to 25 m/s
ADAPTATION_RADPS = 1.0  # so fast does the driver notice that the vehicle turns less than expected


class DriverSteeringParams(NamedTuple):
    """Numbers of the driver, and the vehicle as the driver knows it."""

    ticks: int  # reaction time
    bandwidth_radps: float
    damping: float
    arm_share: float  # of the way to the wanted curvature in one tick, twice in series
    car_share: float  # the same of the vehicle, as the driver expects it to follow
    steering: SteeringMap
    chassis_speed: float  # 0: the vehicle reports no speed, that of the INS is used


class DriverSteeringState(NamedTuple):
    """What the driver has seen and not answered yet, and what the arms do.

    lateral_m, rate_mps: error and its rate during the reaction time (rings). oldest: the oldest one's place.
    observed_m: lateral error as carried on by the heading; NAN before the first tick.
    ahead_1pm, beside_1pm: curvature with which the vehicle has to turn for the road ahead and beside it (`turn_in`).
    first_1pm, second_1pm: curvature that the arms steer. expected_1pm: what the vehicle should follow with by now.
    adapted_1pm: what the driver adds because the vehicle turns less (or more) than expected.
    """

    lateral_m: Any
    rate_mps: Any
    oldest: int
    observed_m: float
    ahead_1pm: float
    beside_1pm: float
    first_1pm: float
    second_1pm: float
    expected_1pm: float
    adapted_1pm: float


def make(setup: Setup) -> Block:
    """x = (Tracking, Measurement) -> steering-wheel angle demand, rad, left positive."""
    values = setup.values
    params = DriverSteeringParams(
        ticks=max(1, round(values["driver.reaction_s"] / setup.dt_s)),
        bandwidth_radps=values["driver.bandwidth_radps"],
        damping=values["driver.damping"],
        arm_share=1.0 - math.exp(-setup.dt_s / values["driver.arm_lag_s"]),
        car_share=1.0 - math.exp(-setup.dt_s / max(expected_lag_s(setup), setup.dt_s)),
        steering=setup.steering,
        chassis_speed=chassis_speed_of(setup.absent),
    )
    return Block(init, step, params, CONTROLLER.tunables)


def expected_lag_s(setup: Setup) -> float:
    """Time from the wheel's demand to the yaw rate, as one lag."""
    delays = setup.delays
    return delays.steer_dead_time_s + delays.steer_lag_s + delays.bus_s + CHASSIS_LAG_S


def init(params: DriverSteeringParams, dt_s: float) -> DriverSteeringState:
    return DriverSteeringState(buffer(params.ticks), buffer(params.ticks), 0, NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@kernel
def step(
    params: DriverSteeringParams, state: DriverSteeringState, x: tuple[Tracking, Measurement], dt_s: float
) -> tuple[DriverSteeringState, float]:
    """Wheel angle for the curvature ahead plus the correction of the error that was there a reaction time ago."""
    tracking, measurement = x
    v = speed_of(measurement, params.chassis_speed)
    lateral_m, rate_mps = float(state.lateral_m[state.oldest]), float(state.rate_mps[state.oldest])
    ahead_1pm = turn_in(params.steering, v, state.ahead_1pm, tracking.preview_curvature_1pm, dt_s)
    beside_1pm = turn_in(params.steering, v, state.beside_1pm, tracking.ref_curvature_1pm, dt_s)
    steady_rad = steady_heading_rad(params.steering, v, beside_1pm)
    observed_m = state.observed_m if state.observed_m == state.observed_m else tracking.lateral_error_m
    seen_mps = v * (tracking.heading_error_rad - steady_rad)
    seen_mps += OBSERVER_RADPS * (tracking.lateral_error_m - observed_m)
    state.lateral_m[state.oldest], state.rate_mps[state.oldest] = tracking.lateral_error_m, seen_mps
    oldest = state.oldest + 1
    if oldest >= params.ticks:
        oldest = 0
    curvature_1pm = ahead_1pm + correction_1pm(params, v, lateral_m, rate_mps)
    first_1pm = state.first_1pm + params.arm_share * (curvature_1pm - state.first_1pm)
    second_1pm = state.second_1pm + params.arm_share * (first_1pm - state.second_1pm)
    expected_1pm = state.expected_1pm + params.car_share * (second_1pm - state.expected_1pm)
    adapted_1pm = adapt(params, state, v, measurement.ins.yaw_rate_radps, dt_s)
    new_state = DriverSteeringState(
        state.lateral_m, state.rate_mps, oldest, observed_m + dt_s * seen_mps,
        ahead_1pm, beside_1pm, first_1pm, second_1pm, expected_1pm, adapted_1pm,
    )  # fmt: skip
    return new_state, wheel_rad(params.steering, steady_road_wheel_rad(params.steering, v, second_1pm + adapted_1pm))


@kernel
def adapt(
    params: DriverSteeringParams, state: DriverSteeringState, speed_mps: float, yaw_rate_radps: float, dt_s: float
) -> float:
    """Curvature that is added, for the vehicle to turn as expected; it stands where the vehicle is slow."""
    if speed_mps < SPEED_FLOOR_MPS or yaw_rate_radps != yaw_rate_radps:
        return state.adapted_1pm
    missing_1pm = state.expected_1pm - yaw_rate_radps / speed_mps
    bound_1pm = CORRECTION_MPS2 / (speed_mps * speed_mps)
    return clamp(state.adapted_1pm + dt_s * ADAPTATION_RADPS * missing_1pm, -bound_1pm, bound_1pm)


@kernel
def turn_in(steering: SteeringMap, speed_mps: float, turning_1pm: float, road_1pm: float, dt_s: float) -> float:
    """Curvature of the turning for a road: behind it by rear axle / speed, as the rear axle follows the front one.

    Without that lag the centre of mass would cut in at low speed: its heading is -rear axle x curvature.
    """
    v = speed_mps if speed_mps > LAG_FLOOR_MPS else LAG_FLOOR_MPS
    share = v * dt_s / (steering.rear_axle_m + v * dt_s)  # not 0: v is at least LAG_FLOOR_MPS
    return turning_1pm + share * (road_1pm - turning_1pm)


@kernel
def steady_heading_rad(steering: SteeringMap, speed_mps: float, curvature_1pm: float) -> float:
    """Heading error of steady cornering at the centre of mass: minus its side-slip, which is no error to a driver."""
    return (steering.rear_slip_s2pm * speed_mps * speed_mps - steering.rear_axle_m) * curvature_1pm


@kernel
def correction_1pm(params: DriverSteeringParams, speed_mps: float, lateral_m: float, rate_mps: float) -> float:
    """Curvature that returns to the path as e'' + 2 damping bandwidth e' + bandwidth^2 e = 0, bounded."""
    v = speed_mps if speed_mps > SPEED_FLOOR_MPS else SPEED_FLOOR_MPS
    radps = params.bandwidth_radps
    wanted_mps2 = -(radps * radps * lateral_m + 2.0 * params.damping * radps * rate_mps)
    wanted_1pm = wanted_mps2 / (v * v)  # not 0: v is at least SPEED_FLOOR_MPS
    bound_1pm = CORRECTION_MPS2 / (v * v)  # not 0: as above
    return clamp(wanted_1pm, -bound_1pm, bound_1pm)


CONTROLLER = Recipe(
    make,
    (
        Tunable("driver.reaction_s", "s", 0.05, 0.5),
        Tunable("driver.bandwidth_radps", "rad/s", 0.2, 2.0),
        Tunable("driver.damping", "1", 0.5, 2.0),
        Tunable("driver.arm_lag_s", "s", 0.02, 0.3),
        Tunable("steer.preview", "1", 0.0, 6.0, "linear"),
    ),
)
