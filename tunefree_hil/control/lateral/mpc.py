"""Lateral MPC: the steering over a horizon, within the bounds of angle and rate, on the model of lqr_preview.py.

States: lateral error, its rate, heading error, its rate (all at the centre of mass, vehicle minus cornering on the
path), and the road-wheel angle of the feedback behind the lag of the steering; over the dead time the state is
predicted with the commands under way. The input is the road-wheel angle beyond the feedforward of lqr_preview.py: what
the path asks for is not weighted. The plan costs, summed over the ticks of the horizon,

    q_lateral e_y^2 + q_lateral_rate e_y'^2 + q_heading e_th^2 + q_heading_rate e_th'^2
    + r_steer u^2 + r_steer_rate u'^2

with ratios by speed on q_lateral, q_heading and r_steer, as Apollo ships them (docs/reference/apollo.md). The bounds
hold for feedback and feedforward together, and the feedforward is known over the horizon from the path ahead: what a
bound would cut short is prepared for. The lateral acceleration is bounded through the angle (limits.py).

Apollo's MPC plans steering and acceleration together, in six states. Its models of both share no term and its weights
are diagonal, so two plans are the same as the joint one (tests/control/mpc/test_condensed.py).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, cast

import numpy as np

from tunefree_hil.base.contracts import Block, Tunable
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import buffer
from tunefree_hil.base.maths import clamp, lerp_table
from tunefree_hil.base.records import Ins, Measurement
from tunefree_hil.control.contract import Recipe, Setup, chassis_speed_of, speed_of
from tunefree_hil.control.filters import butterworth_delay_s
from tunefree_hil.control.lateral import lqr_preview
from tunefree_hil.control.lateral.lqr import (
    NODES_MPS,
    SPEED_FLOOR_MPS,
    LateralModelConstants,
    fill_continuous,
    lateral_model_constants,
)
from tunefree_hil.control.lateral.lqr_preview import (
    INTEGRAL_ERROR_M,
    INTEGRAL_LIMIT_RAD,
    INTEGRAL_SPEED_MPS,
    LEAST_LAG_S,
    STATES,
    Cornering,
    corner,
    feedforward_road_wheel_rad,
)
from tunefree_hil.control.limits import SteerBound, steer_bound, steer_bound_of
from tunefree_hil.control.mpc import plan as plans
from tunefree_hil.control.mpc.condensed import PlanWeights, condense, discretise, divide_horizon, tabulate
from tunefree_hil.control.mpc.settings import HORIZON, plan_settings, require_weights
from tunefree_hil.control.mpc.solver import MpcCriteria, require_osqp
from tunefree_hil.control.path import Path, cell_of, heading_at, project
from tunefree_hil.control.steering_map import SteeringMap, stiffness_of, wheel_rad

# Ratios by speed on the weights (docs/reference/apollo.md).
SCHEDULE_MPS = (2.5, 5.0, 10.0, 15.0, 20.0, 25.0)
LATERAL_RATIO = (1.0, 1.0, 0.4, 0.3, 0.2, 0.1)
HEADING_RATIO = (1.0, 1.0, 0.5, 0.4, 0.35, 0.35)
STEER_RATIO = (1.0, 1.0, 1.1, 1.1, 1.35, 1.55)
INPUT_SIZE_RAD = 0.1  # of road wheel: half of full lock is 0.25


class LateralMpcParams(NamedTuple):
    """Planner, model of the feedforward, bounds. Times in ticks."""

    planner: plans.Planner
    path: Path  # of this drive
    change_s: np.ndarray  # seconds between the middles of two moves
    dead_ticks: int
    lead_s: float  # from a command to the wheel's answer: how far ahead the feedforward reads the path
    lag_share: float  # of the way to the command that the steering goes in one tick
    steering: SteeringMap
    car: LateralModelConstants
    integral_1ps: float
    bound: SteerBound
    rate_radps: float  # of the road wheel
    chassis_speed: float  # 0: the vehicle reports no speed, that of the INS is used


class LateralMpcState(NamedTuple):
    """The plan; what is under way and where the wheel is; place on the path; cornering; integral.

    under_way_rad: feedback commands that have not acted yet, oldest first. cell: of the path, at the centre of mass.
    input_rad: last feedback command. total_rad: last command of feedback and feedforward. All of the road wheel.
    """

    plan: plans.PlanState
    under_way_rad: tuple[float, ...]
    steered_rad: float
    cell: int
    ahead: Cornering
    beside: Cornering
    integral_rad: float
    input_rad: float
    total_rad: float


def make(setup: Setup, criteria: MpcCriteria | None = None) -> Block:
    """x = (Tracking, Measurement) -> steering-wheel angle demand, rad, left positive."""
    require_osqp("lateral")
    values, vehicle, dt_s = setup.values, setup.vehicle, setup.dt_s
    require_weights(values, ("mpc.r_steer",), WEIGHTS)
    delays, reach = setup.delays, values["steer.predict"]
    dead_time_s = delays.steer_dead_time_s + delays.bus_s + butterworth_delay_s(setup.settings.cutoff_hz)
    dead_ticks, lag_s = round(reach * dead_time_s / dt_s), max(reach * delays.steer_lag_s, LEAST_LAG_S)
    front, rear = stiffness_of(setup.steering, vehicle)
    car = lateral_model_constants(vehicle._replace(front_stiffness_n_per_rad=front, rear_stiffness_n_per_rad=rear))
    settings = plan_settings(values)
    lengths = divide_horizon(settings.horizon_s, settings.step_s, dt_s)
    programs = []
    for speed_mps in NODES_MPS:
        a, b = continuous_model(max(speed_mps, SPEED_FLOOR_MPS), car, lag_s)
        weights = weights_at(setup, speed_mps, is_terminal_riccati=settings.is_terminal_riccati)
        programs.append(condense(discretise(a, b, dt_s), weights, lengths, dead_ticks, dt_s))
    chosen = criteria or MpcCriteria()
    planner = plans.make_planner(
        tabulate(NODES_MPS, programs), lengths, INPUT_SIZE_RAD, chosen, is_timed=setup.is_realtime
    )
    params = LateralMpcParams(
        planner=planner,
        path=setup.path,
        change_s=plans.middle_distances_s(lengths, dt_s),
        dead_ticks=dead_ticks,
        lead_s=lead_time_s(setup),
        lag_share=1.0 - math.exp(-dt_s / lag_s),
        steering=setup.steering,
        car=car,
        integral_1ps=values["steer.integral_1ps"],
        bound=steer_bound_of(setup),
        rate_radps=vehicle.steer_rate_radps / vehicle.steer_ratio,
        chassis_speed=chassis_speed_of(setup.absent),
    )
    return Block(init, step, params, CONTROLLER.tunables)


def lead_time_s(setup: Setup) -> float:
    """From a command to the wheel's answer: dead time and lag, times `steer.preview`."""
    delays = setup.delays
    delay_s = delays.steer_dead_time_s + delays.steer_lag_s + delays.bus_s
    return setup.values["steer.preview"] * (delay_s + butterworth_delay_s(setup.settings.cutoff_hz))


def continuous_model(speed_mps: float, car: LateralModelConstants, lag_s: float) -> tuple[np.ndarray, np.ndarray]:
    """(a, b) of x' = a x + b u: the lateral error model of lqr.py, steered through a lag."""
    flat = buffer(STATES * STATES)
    fill_continuous(flat, STATES, speed_mps, car)
    a, b = np.array(flat, dtype=float).reshape(STATES, STATES), np.zeros(STATES)
    a[1, 4] = car.front_stiffness_n_per_rad / car.mass_kg
    a[3, 4] = car.front_axle_m * car.front_stiffness_n_per_rad / car.yaw_inertia_kgm2
    a[4, 4], b[4] = -1.0 / lag_s, 1.0 / lag_s
    return a, b


def weights_at(setup: Setup, speed_mps: float, *, is_terminal_riccati: bool) -> PlanWeights:
    """The weights at a speed."""
    values = setup.values
    states = (
        values["mpc.q_lateral"] * lerp_table(SCHEDULE_MPS, LATERAL_RATIO, speed_mps),
        values["mpc.q_lateral_rate"],
        values["mpc.q_heading"] * lerp_table(SCHEDULE_MPS, HEADING_RATIO, speed_mps),
        values["mpc.q_heading_rate"],
        0.0,
    )
    move = values["mpc.r_steer"] * lerp_table(SCHEDULE_MPS, STEER_RATIO, speed_mps)
    return PlanWeights(states, move, values["mpc.r_steer_rate"], is_terminal_riccati)


def init(params: LateralMpcParams, dt_s: float) -> LateralMpcState:
    """Nothing under way, no plan, straight on at station 0."""
    return LateralMpcState(
        plan=plans.first_plan(params.planner),
        under_way_rad=(0.0,) * params.dead_ticks,
        steered_rad=0.0,
        cell=cell_of(params.path, params.car.rear_axle_m),
        ahead=Cornering(0.0, 0.0),
        beside=Cornering(0.0, 0.0),
        integral_rad=0.0,
        input_rad=0.0,
        total_rad=0.0,
    )


def step(
    params: LateralMpcParams, state: LateralMpcState, x: tuple[Tracking, Measurement], dt_s: float
) -> tuple[LateralMpcState, float]:
    """Feedforward for the curvature ahead, plus the first move of the plan."""
    tracking, measurement = x
    v = speed_of(measurement, params.chassis_speed)
    beside = corner(params.car, state.beside, v, tracking.ref_curvature_1pm, dt_s)
    ahead = corner(params.car, state.ahead, v, tracking.preview_curvature_1pm, dt_s)
    cell, curvature_1pm = curvature_over_horizon(params, state.cell, tracking, measurement.ins, dt_s)
    forward_rad = feedforward_over_horizon(params, curvature_1pm, ahead, v, dt_s)
    known = (
        tracking.lateral_error_m,
        tracking.lateral_error_rate_mps - v * math.sin(beside.heading_rad),
        tracking.heading_error_rad - beside.heading_rad,
        tracking.heading_error_rate_radps - (beside.yaw_rate_radps - tracking.ref_curvature_1pm * v),
        state.steered_rad,
        *state.under_way_rad,
        state.input_rad,
    )
    bound_rad, reach_rad = road_wheel_bound(params, v), params.rate_radps * dt_s
    bounds = plan_bounds(params, np.array(forward_rad), state.total_rad, bound_rad, reach_rad)
    plan = plans.next_plan(params.planner, state.plan, abs(v), known, bounds)
    wanted_rad = clamp(forward_rad[0] + plans.move_now(params.planner, plan), -bound_rad, bound_rad)
    total_rad = clamp(wanted_rad, state.total_rad - reach_rad, state.total_rad + reach_rad)
    demand_rad = wheel_rad(params.steering, total_rad + state.integral_rad)
    integral_rad = next_integral(params, state.integral_rad, tracking.lateral_error_m, v, demand_rad, dt_s)
    input_rad = total_rad - forward_rad[0]
    under_way = (*state.under_way_rad, input_rad)
    steered_rad = state.steered_rad + params.lag_share * (under_way[0] - state.steered_rad)
    new_state = LateralMpcState(
        plan, under_way[1:], steered_rad, cell, ahead, beside, integral_rad, input_rad, total_rad
    )
    return new_state, demand_rad


def curvature_over_horizon(
    params: LateralMpcParams, cell: int, tracking: Tracking, ins: Ins, dt_s: float
) -> tuple[int, list[float]]:
    """(cell of the path, curvature where the centre of mass will be when each move acts).

    The first one is that of the follower. The others are of the path itself, reached with the present speed and the
    planned acceleration; the blend after a re-plan is not in them.
    """
    cos, sin, rear_m = math.cos(ins.heading_rad), math.sin(ins.heading_rad), params.car.rear_axle_m
    place = project(params.path, cell, ins.x_m + rear_m * cos, ins.y_m + rear_m * sin)
    side = rear_m * tracking.ref_curvature_1pm
    speed_mps, accel_mps2 = abs(ins.speed_mps) * math.sqrt(1.0 + side * side), tracking.preview_accel_mps2
    standing_s = speed_mps / -accel_mps2 if accel_mps2 < 0.0 else math.inf
    curvature_1pm = [tracking.preview_curvature_1pm]
    for start in params.planner.starts[1:]:
        later_s = min(params.lead_s + start * dt_s, standing_s)
        run_m = later_s * (speed_mps + 0.5 * accel_mps2 * later_s)
        curvature_1pm.append(heading_at(params.path, place.station_m + run_m)[1])
    return place.cell, curvature_1pm


def feedforward_over_horizon(
    params: LateralMpcParams, curvature_1pm: list[float], ahead: Cornering, v: float, dt_s: float
) -> list[float]:
    """Road-wheel angle that the path asks for at the begin of each move, at the present speed."""
    model = cast(Any, params)  # `steering` and `car` are what it reads
    forward_rad = [feedforward_road_wheel_rad(model, ahead, v, curvature_1pm[0])]
    for kappa_1pm, length in zip(curvature_1pm[1:], params.planner.lengths, strict=False):
        ahead = corner(params.car, ahead, v, kappa_1pm, length * dt_s)
        forward_rad.append(feedforward_road_wheel_rad(model, ahead, v, kappa_1pm))
    return forward_rad


def road_wheel_bound(params: LateralMpcParams, speed_mps: float) -> float:
    """Largest road-wheel angle of a command: what the bound of the steering wheel leaves with dead zone and offset."""
    taken_rad = abs(params.steering.offset_rad) + params.steering.dead_zone_rad
    return max(steer_bound(params.bound, speed_mps) - taken_rad, 0.0) / params.steering.steer_ratio


def plan_bounds(
    params: LateralMpcParams, forward_rad: np.ndarray, total_rad: float, bound_rad: float, reach_rad: float
) -> plans.PlanBounds:
    """Bounds of the feedback moves, such that feedback and feedforward keep to the bounds of angle and rate."""
    reach = np.concatenate([[reach_rad], params.rate_radps * params.change_s])
    low, high = plans.bound_totals(total_rad, (-bound_rad, bound_rad), reach)
    change = np.diff(forward_rad)
    return plans.PlanBounds(low - forward_rad, high - forward_rad, -reach[1:] - change, reach[1:] - change)


def next_integral(
    params: LateralMpcParams, integral_rad: float, lateral_m: float, v: float, demand_rad: float, dt_s: float
) -> float:
    """The slow integral of lqr_preview.py: it stands at a bound, far from the path, and at low speed."""
    at_bound = abs(demand_rad) >= steer_bound(params.bound, v)
    if abs(lateral_m) >= INTEGRAL_ERROR_M or v <= INTEGRAL_SPEED_MPS or at_bound:
        return integral_rad
    gain = lerp_table(params.planner.table.nodes, params.planner.table.gains, abs(v))
    change_rad = params.integral_1ps * dt_s * gain * lateral_m
    return clamp(integral_rad - change_rad, -INTEGRAL_LIMIT_RAD, INTEGRAL_LIMIT_RAD)


def has_failed(params: LateralMpcParams, state: LateralMpcState) -> bool:
    """Whether there was no plan for too long."""
    return plans.has_failed(params.planner, state.plan)


# Boxes: the gains are about sqrt(q / r_steer), so those of the LQR (control/parameters.py) with r_steer at 1.
WEIGHTS = (
    Tunable("mpc.q_lateral", "1/m2", 1e-4, 1.0),
    Tunable("mpc.q_lateral_rate", "s2/m2", 1e-6, 0.1),
    Tunable("mpc.q_heading", "1/rad2", 1e-4, 4.0),
    Tunable("mpc.q_heading_rate", "s2/rad2", 1e-6, 0.1),
    Tunable("mpc.r_steer", "1/rad2", 0.1, 10.0),
    # Low: the commands are smoothed over 0.01 s, a tick. High: over 0.5 s, longer than dead time and lag together.
    Tunable("mpc.r_steer_rate", "s2/rad2", 1e-4, 0.25),
)
DEFAULTS = {
    "mpc.q_lateral": 0.05,
    "mpc.q_lateral_rate": 0.0,
    "mpc.q_heading": 1.0,
    "mpc.q_heading_rate": 0.0,
    "mpc.r_steer": 1.0,
    "mpc.r_steer_rate": 0.01,
    **HORIZON.defaults,
}
CONTROLLER = Recipe(
    make,
    WEIGHTS + HORIZON.tunables + lqr_preview.OWN,
    knows_steering=True,
    defaults=DEFAULTS,
    has_failed=has_failed,
    is_kernel=False,
)
