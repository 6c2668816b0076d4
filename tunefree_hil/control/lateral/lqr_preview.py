"""Lateral LQR that knows the steering: steering map, preview, prediction over the dead time, slow integral.

The paper's plain form is lqr.py. Here the same Q (eq. 4) and error states are used, and four things are added, each
with a parameter of its own, 0 for off:

- feedforward from the steering map (control/steering_map.py) instead of the data sheet, and through the inverse of the
  single-track model: steering and heading with which the centre of mass stays on the path while the curvature changes
  (`Cornering`). A steady-state feedforward (eq. 3) comes rear axle / speed too early: 0.3 s at 5 m/s;
- `steer.preview`: the feedforward's curvature is taken when the wheel will have got there, so many times the
  identified dead time + lag later on the reference;
- `steer.predict`: feedback on the error that will be there after the dead time. The model of the LQR has the lag of
  the steering as a fifth state, and its input acts n ticks later. The optimal feedback of such a system is the LQR gain
  on the state predicted over the dead time with the commands that are under way (Smith 1957; Artstein 1982, IEEE TAC
  27, 869-879), which comes to one gain a state and one a command under way;
- `steer.integral_1ps`: integral of the lateral part of the feedback, for what the map does not know (a bank, an
  offset). It stands while the command is at a bound or the vehicle is far from the path or slow (anti-windup).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block, Tunable
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import buffer, compiled, kernel, table
from tunefree_hil.base.maths import clamp, find_cell, lerp_table
from tunefree_hil.base.records import Measurement
from tunefree_hil.control import riccati
from tunefree_hil.control.contract import Recipe, Setup, chassis_speed_of, speed_of
from tunefree_hil.control.filters import butterworth_delay_s
from tunefree_hil.control.lateral.lqr import (
    HEADING_RATIO,
    INPUT_WEIGHT,
    LATERAL_RATIO,
    NODES_MPS,
    SCHEDULE_MPS,
    SPEED_FLOOR_MPS,
    LateralModelConstants,
    fill_continuous,
    lateral_model_constants,
)
from tunefree_hil.control.limits import SteerBound, steer_bound, steer_bound_of
from tunefree_hil.control.parameters import tunables_of
from tunefree_hil.control.steering_map import (
    SteeringMap,
    steady_road_wheel_rad,
    stiffness_of,
    wheel_rad,
)

STATES = 5  # lateral error, its rate, heading error, its rate, road-wheel angle of the feedback
LEAST_LAG_S = 0.02  # a faster steering is modelled as this fast: two ticks
INTEGRAL_LIMIT_RAD = 0.03  # of road wheel: the steady error of a data-sheet map at 5 m/s2 is 0.02
INTEGRAL_ERROR_M = 0.3  # further away it is a transient, not a steady error
INTEGRAL_SPEED_MPS = 1.0


class LqrPreviewParams(NamedTuple):
    """Gains by speed (rows of `width`: K1 to K5, then one for each command under way, oldest first), map, bounds."""

    speed_mps: Any
    gains: Any
    width: int
    lag_share: float  # of the way to the command that the steering goes in one tick
    steering: SteeringMap
    car: LateralModelConstants
    integral_1ps: float
    bound: SteerBound
    chassis_speed: float  # 0: the vehicle reports no speed, that of the INS is used


class Cornering(NamedTuple):
    """Heading error and yaw rate with which the centre of mass stays on a path of changing curvature."""

    heading_rad: float
    yaw_rate_radps: float


class LqrPreviewState(NamedTuple):
    """Feedback commands under way (road-wheel rad, a ring), the oldest one's place, where the wheel is, integral.

    ahead, beside: cornering for the curvature of the preview, and for that beside the vehicle.
    """

    under_way_rad: Any
    oldest: int
    steered_rad: float
    integral_rad: float
    ahead: Cornering
    beside: Cornering


def make(setup: Setup) -> Block:
    """x = (Tracking, Measurement) -> steering-wheel angle demand, rad, left positive."""
    values, vehicle, dt_s = setup.values, setup.vehicle, setup.dt_s
    reach = values["steer.predict"]
    dead_time_s = setup.delays.steer_dead_time_s + setup.delays.bus_s + butterworth_delay_s(setup.settings.cutoff_hz)
    ticks = round(reach * dead_time_s / dt_s)
    lag_s = max(reach * setup.delays.steer_lag_s, LEAST_LAG_S)
    front, rear = stiffness_of(setup.steering, vehicle)
    car = lateral_model_constants(vehicle._replace(front_stiffness_n_per_rad=front, rear_stiffness_n_per_rad=rear))
    weights = (values["lqr.q1"], values["lqr.q2"], values["lqr.q3"], values["lqr.q4"])
    width = STATES + ticks
    gains = buffer(width * len(NODES_MPS))
    fill_preview_gains_fast(gains, table(NODES_MPS), weights, car, lag_s, dt_s, ticks, make_preview_buffers())
    params = LqrPreviewParams(
        speed_mps=table(NODES_MPS),
        gains=table(gains),
        width=width,
        lag_share=1.0 - math.exp(-dt_s / lag_s),
        steering=setup.steering,
        car=car,
        integral_1ps=values["steer.integral_1ps"],
        bound=steer_bound_of(setup),
        chassis_speed=chassis_speed_of(setup.absent),
    )
    return Block(init, step, params, CONTROLLER.tunables)


class PreviewBuffers(NamedTuple):
    """Buffers for `fill_preview_gains`: two of 5 x 5 for the model, B, Q, P, K, a row, and riccati's own."""

    a: Any
    minus: Any
    b: Any
    q: Any
    p: Any
    gain: Any
    row: Any
    work: riccati.RiccatiBuffers


def make_preview_buffers() -> PreviewBuffers:
    """The buffers for five states."""
    square = STATES * STATES
    return PreviewBuffers(
        a=buffer(square),
        minus=buffer(square),
        b=buffer(STATES),
        q=buffer(square),
        p=buffer(square),
        gain=buffer(STATES),
        row=buffer(STATES),
        work=riccati.make_buffers(STATES),
    )


@kernel
def fill_lagged_model(
    s: PreviewBuffers, speed_mps: float, car: LateralModelConstants, lag_s: float, dt_s: float
) -> None:
    """Fill s.a and s.b: the lateral error model of lqr.py, steered through a lag; Tustin, the input held."""
    n = STATES
    for i in range(n * n):
        s.minus[i] = 0.0
    fill_continuous(s.minus, n, speed_mps, car)
    if car.mass_kg > 0.0 and car.yaw_inertia_kgm2 > 0.0:
        s.minus[n + 4] = car.front_stiffness_n_per_rad / car.mass_kg
        s.minus[3 * n + 4] = car.front_axle_m * car.front_stiffness_n_per_rad / car.yaw_inertia_kgm2
    rate_1ps = 1.0 / lag_s if lag_s > 0.0 else 0.0
    s.minus[4 * n + 4] = -rate_1ps
    for i in range(4):
        s.b[i] = 0.0
    s.b[4] = dt_s * rate_1ps
    for i in range(n):
        for j in range(n):
            half = 0.5 * dt_s * s.minus[i * n + j]
            identity = 1.0 if i == j else 0.0
            s.minus[i * n + j], s.a[i * n + j] = identity - half, identity + half
    for i in range(n * n):
        s.p[i] = s.minus[i]  # `solve` overwrites the matrix, which is needed twice
    riccati.solve(s.minus, s.a, n, n)
    riccati.solve(s.p, s.b, n, 1)


@kernel
def fill_preview_gains(
    gains: Any,
    speeds: Any,
    weights: tuple[float, float, float, float],
    car: LateralModelConstants,
    lag_s: float,
    dt_s: float,
    ticks: int,
    s: PreviewBuffers,
) -> None:
    """Gains at each speed into rows of 5 + ticks: K A^ticks, then K A^(ticks - 1 - j) B of the j-th oldest command."""
    n = STATES
    width = n + ticks
    for k in range(len(speeds)):
        speed = float(speeds[k])
        fill_lagged_model(s, speed if speed > SPEED_FLOOR_MPS else SPEED_FLOOR_MPS, car, lag_s, dt_s)
        for i in range(n * n):
            s.q[i] = 0.0
        s.q[0] = weights[0] * lerp_table(SCHEDULE_MPS, LATERAL_RATIO, speed)
        s.q[n + 1] = weights[1]
        s.q[2 * (n + 1)] = weights[2] * lerp_table(SCHEDULE_MPS, HEADING_RATIO, speed)
        s.q[3 * (n + 1)] = weights[3]
        riccati.solve_gain(s.gain, s.p, s.a, s.b, s.q, INPUT_WEIGHT, n, False, s.work)
        for j in range(ticks - 1, -1, -1):  # the newest command first: it has acted for no tick yet
            total = 0.0
            for i in range(n):
                total += s.gain[i] * s.b[i]
            gains[k * width + n + j] = total
            for i in range(n):
                s.row[i] = 0.0
                for m in range(n):
                    s.row[i] += s.gain[m] * s.a[m * n + i]
            for i in range(n):
                s.gain[i] = s.row[i]
        for i in range(n):
            gains[k * width + i] = float(s.gain[i])


fill_preview_gains_fast = compiled(fill_preview_gains)


def init(params: LqrPreviewParams, dt_s: float) -> LqrPreviewState:
    """Nothing under way, no integral."""
    straight = Cornering(0.0, 0.0)
    return LqrPreviewState(buffer(max(params.width - STATES, 1)), 0, 0.0, 0.0, straight, straight)


@kernel
def step(
    params: LqrPreviewParams, state: LqrPreviewState, x: tuple[Tracking, Measurement], dt_s: float
) -> tuple[LqrPreviewState, float]:
    """Feedforward for the curvature ahead, minus predictive feedback on what differs from cornering on the path."""
    tracking, measurement = x
    v = speed_of(measurement, params.chassis_speed)
    beside = corner(params.car, state.beside, v, tracking.ref_curvature_1pm, dt_s)
    ahead = corner(params.car, state.ahead, v, tracking.preview_curvature_1pm, dt_s)
    lateral_m = tracking.lateral_error_m
    errors = (
        lateral_m,
        tracking.lateral_error_rate_mps - v * math.sin(beside.heading_rad),
        tracking.heading_error_rad - beside.heading_rad,
        tracking.heading_error_rate_radps - (beside.yaw_rate_radps - tracking.ref_curvature_1pm * v),
        state.steered_rad,
    )
    lateral_gain, feedback_rad = predictive_feedback(params, state, errors, abs(v))
    forward_rad = feedforward_road_wheel_rad(params, ahead, v, tracking.preview_curvature_1pm)
    demand_rad = wheel_rad(params.steering, forward_rad + feedback_rad + state.integral_rad)
    integral_rad = state.integral_rad
    at_bound = abs(demand_rad) >= steer_bound(params.bound, v)
    if abs(lateral_m) < INTEGRAL_ERROR_M and v > INTEGRAL_SPEED_MPS and not at_bound:
        integral_rad -= params.integral_1ps * dt_s * lateral_gain * lateral_m
        integral_rad = clamp(integral_rad, -INTEGRAL_LIMIT_RAD, INTEGRAL_LIMIT_RAD)
    return advance(params, state, feedback_rad, integral_rad, ahead, beside), demand_rad


@kernel
def corner(
    car: LateralModelConstants, state: Cornering, speed_mps: float, curvature_1pm: float, dt_s: float
) -> Cornering:
    """Cornering a tick later, by the zero dynamics of the single-track model with the lateral error as its output.

    With the lateral error held at 0: heading' = yaw rate - v kappa, and yaw rate' = -(L c_r / I) (heading + lr yaw rate
    / v) + (lf m v / I) v kappa. Its steady state is that of eq. 3. Backward Euler, which is stable at any speed.
    """
    v = speed_mps if speed_mps > SPEED_FLOOR_MPS else SPEED_FLOOR_MPS
    inertia = car.yaw_inertia_kgm2
    if inertia <= 0.0:
        return state
    turn_radps = v * curvature_1pm
    stiff = (car.front_axle_m + car.rear_axle_m) * car.rear_stiffness_n_per_rad / inertia
    damp = stiff * car.rear_axle_m / v  # not 0: SPEED_FLOOR_MPS or more
    drive = car.front_axle_m * car.mass_kg * v / inertia
    yaw_radps = state.yaw_rate_radps + dt_s * ((drive + stiff * dt_s) * turn_radps - stiff * state.heading_rad)
    yaw_radps = yaw_radps / (1.0 + dt_s * damp + dt_s * dt_s * stiff)  # not 0: 1 and positive numbers
    return Cornering(state.heading_rad + dt_s * (yaw_radps - turn_radps), yaw_radps)


@kernel
def feedforward_road_wheel_rad(
    params: LqrPreviewParams, ahead: Cornering, speed_mps: float, curvature_1pm: float
) -> float:
    """Road-wheel angle that keeps the centre of mass on the path, plus what the map has beyond the linear model."""
    car = params.car
    cf, cr, lf, lr = car.front_stiffness_n_per_rad, car.rear_stiffness_n_per_rad, car.front_axle_m, car.rear_axle_m
    v = speed_mps if speed_mps > SPEED_FLOOR_MPS else SPEED_FLOOR_MPS
    if cf <= 0.0:
        return 0.0
    turning = lr * cr - lf * cf
    slip_n = turning * ahead.yaw_rate_radps / v  # not 0: SPEED_FLOOR_MPS or more
    force_n = car.mass_kg * v * v * curvature_1pm - (cf + cr) * ahead.heading_rad - slip_n
    linear_rad = (lf + lr + params.steering.understeer_s2pm * v * v) * curvature_1pm
    return force_n / cf + steady_road_wheel_rad(params.steering, v, curvature_1pm) - linear_rad


@kernel
def predictive_feedback(
    params: LqrPreviewParams,
    state: LqrPreviewState,
    errors: tuple[float, float, float, float, float],
    speed_mps: float,
) -> tuple[float, float]:
    """(gain on the lateral error, feedback in road-wheel rad): linear between the speeds of the table."""
    nodes, gains, width = params.speed_mps, params.gains, params.width
    node = find_cell(nodes, speed_mps)
    share = clamp((speed_mps - nodes[node]) / (nodes[node + 1] - nodes[node]), 0.0, 1.0)  # not 0: strictly ascending
    low, high = node * width, (node + 1) * width
    first = gains[low] + share * (gains[high] - gains[low])
    total = 0.0
    for i in range(STATES):
        total += (gains[low + i] + share * (gains[high + i] - gains[low + i])) * errors[i]
    ticks = width - STATES
    place = state.oldest
    for j in range(STATES, STATES + ticks):
        total += (gains[low + j] + share * (gains[high + j] - gains[low + j])) * state.under_way_rad[place]
        place += 1
        if place == ticks:
            place = 0
    return first, -total


@kernel
def advance(
    params: LqrPreviewParams,
    state: LqrPreviewState,
    feedback_rad: float,
    integral_rad: float,
    ahead: Cornering,
    beside: Cornering,
) -> LqrPreviewState:
    """The state a tick later: the oldest command under way reaches the steering, the new one sets out."""
    ticks = params.width - STATES
    acting_rad, oldest = feedback_rad, 0
    if ticks > 0:
        acting_rad = float(state.under_way_rad[state.oldest])
        state.under_way_rad[state.oldest] = feedback_rad
        oldest = state.oldest + 1
        if oldest == ticks:
            oldest = 0
    steered_rad = state.steered_rad + params.lag_share * (acting_rad - state.steered_rad)
    return LqrPreviewState(state.under_way_rad, oldest, steered_rad, integral_rad, ahead, beside)


OWN = (
    Tunable("steer.preview", "1", 0.0, 2.0, "linear"),
    Tunable("steer.predict", "1", 0.0, 2.0, "linear"),
    Tunable("steer.integral_1ps", "1/s", 0.0, 0.04, "linear"),
)
CONTROLLER = Recipe(make, tunables_of("lqr.") + OWN, knows_steering=True)
