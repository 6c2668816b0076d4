"""Lateral LQR with feedforward: eq. 3 and 4 of the paper, docs/reference/apollo.md and docs/reference/controller.md.

States X = [e_y, e_y', e_th, e_th'] at the centre of mass (vehicle - reference, left positive), input road-wheel angle.
The gains are computed at build time for a list of speeds and interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import buffer, compiled, kernel, table
from tunefree_hil.base.maths import find_cell, lerp_table
from tunefree_hil.base.records import Measurement
from tunefree_hil.control import riccati
from tunefree_hil.control.contract import LeadLag, Recipe, Setup, VehicleConstants, chassis_speed_of, speed_of
from tunefree_hil.control.filters import FirstOrder, first_order, first_order_step
from tunefree_hil.control.parameters import RICCATI_CODES, tunables_of

SPEED_FLOOR_MPS = 0.1  # of the model (docs/reference/apollo.md)
# Dense where the gains are not linear: at low speed, and at the nodes of the gain scheduler.
NODES_MPS = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0)
NODES_MPS += (5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 14.0, 16.0, 18.0, 20.0, 22.5, 25.0, 30.0, 40.0)
# Gain scheduler: ratios by speed on Q1 and Q3 (docs/reference/apollo.md).
SCHEDULE_MPS = (4.0, 8.0, 12.0, 20.0, 25.0)
LATERAL_RATIO = (1.0, 0.6, 0.2, 0.1, 0.05)
HEADING_RATIO = (1.0, 0.6, 0.4, 0.2, 0.1)
INPUT_WEIGHT = 1.0  # R
LOW_SPEED_MPS = 3.0  # the lead-lag is active below it and faded over the window
LOW_SPEED_WINDOW_MPS = 1.0


class LqrParams(NamedTuple):
    """Gain tables over speed, and constants of the feedforward. Stiffness per axle."""

    speed_mps: Any
    k1: Any
    k2: Any
    k3: Any
    k4: Any
    wheelbase_m: float
    rear_axle_m: float
    understeer_s2pm: float  # k_v
    rear_slip_s2pm: float  # lf m / (c_r L)
    look_ahead_m: float
    steer_ratio: float
    lead_lag_weight: float
    lead_lag: FirstOrder
    chassis_speed: float  # 0: the vehicle reports no speed, that of the INS is used


class LqrState(NamedTuple):
    """Inner state of the lead-lag."""

    lead_lag: float


class Feedback(NamedTuple):
    """K at one speed: rad of road wheel by m, m/s, rad, rad/s."""

    k1: float
    k2: float
    k3: float
    k4: float


def make(setup: Setup) -> Block:
    """x = (Tracking, Measurement) -> steering-wheel angle demand, rad, left positive."""
    values, vehicle = setup.values, setup.vehicle
    weights = (values["lqr.q1"], values["lqr.q2"], values["lqr.q3"], values["lqr.q4"])
    shipped = values["riccati"] == RICCATI_CODES["apollo150"]
    rows = gain_rows(NODES_MPS, weights, vehicle, setup.dt_s, shipped=shipped)
    length_m, rear_axle_m = vehicle.wheelbase_m, vehicle.rear_axle_m
    rear_slip = vehicle.front_axle_m * vehicle.mass_kg / (vehicle.rear_stiffness_n_per_rad * length_m)
    front_slip = rear_axle_m * vehicle.mass_kg / (vehicle.front_stiffness_n_per_rad * length_m)
    lead_lag: LeadLag = setup.settings.lead_lag
    params = LqrParams(
        speed_mps=table(NODES_MPS),
        k1=table(row[0] for row in rows),
        k2=table(row[1] for row in rows),
        k3=table(row[2] for row in rows),
        k4=table(row[3] for row in rows),
        wheelbase_m=length_m,
        rear_axle_m=rear_axle_m,
        understeer_s2pm=front_slip - rear_slip,
        rear_slip_s2pm=rear_slip,
        look_ahead_m=values["look_ahead_m"],
        steer_ratio=vehicle.steer_ratio,
        lead_lag_weight=lead_lag.weight,
        lead_lag=first_order(lead_lag, setup.dt_s),
        chassis_speed=chassis_speed_of(setup.absent),
    )
    return Block(init, step, params, CONTROLLER.tunables)


def model(speed_mps: float, vehicle: VehicleConstants, dt_s: float) -> tuple[Any, Any]:
    """(A, B), flat by rows, of the lateral error model (`fill_model`)."""
    a, b, work = buffer(16), buffer(4), riccati.make_buffers(4)
    fill_model(a, b, max(speed_mps, SPEED_FLOOR_MPS), lateral_model_constants(vehicle), dt_s, work.w)
    return a, b


class LateralModelConstants(NamedTuple):
    """Constants of the single-track model. Stiffness is per axle; axle positions are distances from the mass centre."""

    front_stiffness_n_per_rad: float
    rear_stiffness_n_per_rad: float
    front_axle_m: float
    rear_axle_m: float
    mass_kg: float  # not 0: config/load.py refuses it
    yaw_inertia_kgm2: float  # not 0: config/load.py refuses it


def lateral_model_constants(vehicle: VehicleConstants) -> LateralModelConstants:
    """The constants of a vehicle for the model."""
    return LateralModelConstants(
        vehicle.front_stiffness_n_per_rad,
        vehicle.rear_stiffness_n_per_rad,
        vehicle.front_axle_m,
        vehicle.rear_axle_m,
        vehicle.mass_kg,
        vehicle.yaw_inertia_kgm2,
    )


@kernel
def fill_continuous(a: Any, width: int, v: float, car: LateralModelConstants) -> None:
    """Fill the first 4 rows and columns of a matrix of `width` columns with the continuous A at a speed v > 0."""
    cf, cr, lf, lr = car.front_stiffness_n_per_rad, car.rear_stiffness_n_per_rad, car.front_axle_m, car.rear_axle_m
    mass_kg, yaw_inertia_kgm2 = car.mass_kg, car.yaw_inertia_kgm2
    total, turning, damping = cf + cr, lr * cr - lf * cf, lf * lf * cf + lr * lr * cr
    if v <= 0.0 or mass_kg <= 0.0 or yaw_inertia_kgm2 <= 0.0:
        return
    lateral = (0.0, -total / (mass_kg * v), total / mass_kg, turning / (mass_kg * v))
    heading = (0.0, turning / (yaw_inertia_kgm2 * v), -turning / yaw_inertia_kgm2, -damping / (yaw_inertia_kgm2 * v))
    rows = ((0.0, 1.0, 0.0, 0.0), lateral, (0.0, 0.0, 0.0, 1.0), heading)
    for i in range(4):
        for j in range(4):
            a[i * width + j] = rows[i][j]


@kernel
def fill_model(a: Any, b: Any, v: float, car: LateralModelConstants, dt_s: float, minus: Any) -> None:
    """Fill A (16, by rows) and B (4) at a speed v > 0: Tustin for A, forward Euler for B, as Apollo does.

    Args:
        v: speed, m/s.
        minus: a buffer of 16 that is overwritten.
    """
    if v <= 0.0 or car.mass_kg <= 0.0 or car.yaw_inertia_kgm2 <= 0.0:
        return
    fill_continuous(minus, 4, v, car)
    for i in range(16):
        identity = 1.0 if i in (0, 5, 10, 15) else 0.0
        half = 0.5 * dt_s * minus[i]
        minus[i], a[i] = identity - half, identity + half
    riccati.solve(minus, a, 4, 4)
    cf, lf = car.front_stiffness_n_per_rad, car.front_axle_m
    b[0], b[1], b[2], b[3] = 0.0, dt_s * cf / car.mass_kg, 0.0, dt_s * lf * cf / car.yaw_inertia_kgm2


class GainBuffers(NamedTuple):
    """Buffers for `fill_gains`: A, B, Q, P, K, and riccati's own."""

    a: Any
    b: Any
    q: Any
    p: Any
    gain: Any
    work: riccati.RiccatiBuffers


@kernel
def fill_gains(
    rows: Any,
    speeds: Any,
    weights: tuple[float, float, float, float],
    car: LateralModelConstants,
    dt_s: float,
    shipped: bool,
    s: GainBuffers,
) -> None:
    """K1..K4 at each speed into rows, for Q1..Q4 (eq. 4) with the gain scheduler on Q1 and Q3."""
    for k in range(len(speeds)):
        speed = float(speeds[k])
        fill_model(s.a, s.b, speed if speed > SPEED_FLOOR_MPS else SPEED_FLOOR_MPS, car, dt_s, s.work.w)
        for i in range(16):
            s.q[i] = 0.0
        s.q[0] = weights[0] * lerp_table(SCHEDULE_MPS, LATERAL_RATIO, speed)
        s.q[5] = weights[1]
        s.q[10] = weights[2] * lerp_table(SCHEDULE_MPS, HEADING_RATIO, speed)
        s.q[15] = weights[3]
        riccati.solve_gain(s.gain, s.p, s.a, s.b, s.q, INPUT_WEIGHT, 4, shipped, s.work)
        for j in range(4):
            rows[4 * k + j] = float(s.gain[j])


fill_gains_fast = compiled(fill_gains)


def gain_rows(
    speeds_mps: Sequence[float],
    weights: tuple[float, float, float, float],
    vehicle: VehicleConstants,
    dt_s: float,
    *,
    shipped: bool,
) -> list[list[float]]:
    """K1..K4 at each speed for Q1..Q4 (`fill_gains`)."""
    rows = buffer(4 * len(speeds_mps))
    solver = GainBuffers(buffer(16), buffer(4), buffer(16), buffer(16), buffer(4), riccati.make_buffers(4))
    fill_gains_fast(rows, table(speeds_mps), weights, lateral_model_constants(vehicle), dt_s, shipped, solver)
    return [[float(rows[4 * k + j]) for j in range(4)] for k in range(len(speeds_mps))]


def init(params: LqrParams, dt_s: float) -> LqrState:
    return LqrState(0.0)


@kernel
def step(params: LqrParams, state: LqrState, x: tuple[Tracking, Measurement], dt_s: float) -> tuple[LqrState, float]:
    """delta_cmd = -K X + delta_ff (eq. 3), times the steering ratio."""
    tracking, measurement = x
    v = speed_of(measurement, params.chassis_speed)
    k = interpolate(params, abs(v))
    lateral_m, heading_rad = tracking.lateral_error_m, tracking.heading_error_rad
    if params.look_ahead_m != 0.0:
        lateral_m += params.look_ahead_m * math.sin(heading_rad)
        heading_rad -= tracking.preview_heading_change_rad
    feedback_rad = -(
        k.k1 * lateral_m
        + k.k2 * tracking.lateral_error_rate_mps
        + k.k3 * heading_rad
        + k.k4 * tracking.heading_error_rate_radps
    )
    inner, boost_rad = low_speed_lead_lag(params, state.lead_lag, -lateral_m, abs(v), dt_s)
    road_wheel_rad = feedback_rad + feedforward(params, k, v, tracking.ref_curvature_1pm) + boost_rad
    return LqrState(inner), road_wheel_rad * params.steer_ratio


@kernel
def interpolate(params: LqrParams, speed_mps: float) -> Feedback:
    """The gains at a speed, linear between nodes, flat outside them."""
    nodes = params.speed_mps
    i = find_cell(nodes, speed_mps)
    share = (speed_mps - nodes[i]) / (nodes[i + 1] - nodes[i])  # not 0: strictly ascending
    if share < 0.0:
        share = 0.0
    elif share > 1.0:
        share = 1.0
    rest = 1.0 - share
    return Feedback(
        rest * params.k1[i] + share * params.k1[i + 1],
        rest * params.k2[i] + share * params.k2[i + 1],
        rest * params.k3[i] + share * params.k3[i + 1],
        rest * params.k4[i] + share * params.k4[i + 1],
    )


@kernel
def feedforward(params: LqrParams, k: Feedback, speed_mps: float, curvature_1pm: float) -> float:
    """delta_ff = L kappa + k_v v^2 kappa + K3 theta_ss (eq. 3) + K2 v sin(theta_ss) (docs/reference/controller.md),
    road-wheel rad.

    theta_ss = -lr kappa + lf m v^2 kappa / (c_r L) is the heading error of steady cornering: minus the side-slip at
    the centre of mass. Its second term follows from the error rate v sin(heading error).
    """
    square = speed_mps * speed_mps
    theta_ss = (params.rear_slip_s2pm * square - params.rear_axle_m) * curvature_1pm
    steady_rad = (params.wheelbase_m + params.understeer_s2pm * square) * curvature_1pm
    return steady_rad + k.k3 * theta_ss + k.k2 * speed_mps * math.sin(theta_ss)


@kernel
def low_speed_lead_lag(
    params: LqrParams, inner: float, error_m: float, speed_mps: float, dt_s: float
) -> tuple[float, float]:
    """(inner state, road-wheel rad) of the low-speed lead-lag (docs/reference/apollo.md; off by default, see
    LeadLag)."""
    if params.lead_lag_weight == 0.0 or speed_mps >= LOW_SPEED_MPS:
        return inner, 0.0
    inner, boost_rad = first_order_step(params.lead_lag, inner, error_m)
    fade = (LOW_SPEED_MPS - speed_mps) / LOW_SPEED_WINDOW_MPS
    if fade < 1.0:
        boost_rad *= fade
    return inner, params.lead_lag_weight * boost_rad


CONTROLLER = Recipe(make, tunables_of("lqr.") + tunables_of("riccati") + tunables_of("look_ahead_m"))
