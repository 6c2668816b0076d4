"""Longitudinal MPC: the acceleration over a horizon, within the vehicle's bounds and those of the open-loop map.

States: station error, speed error (reference minus vehicle), and the acceleration of the feedback behind the lag of the
driveline; over the dead time the state is predicted with the accelerations under way. The input is the acceleration
beyond the plan's. The plan of inputs costs, summed over the ticks of the horizon,

    q_station e_x^2 + q_speed e_v^2 + r_accel u^2 + r_accel_rate u'^2

Estimator, disturbance observer and pedals are those of pid_preview.py, with their parameters; the observer is what
takes out a steady error, as a plan has no integral.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple, cast

import numpy as np

from tunefree_hil.base.contracts import Block, Tunable
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import Measurement
from tunefree_hil.control.calibration_map import lookup
from tunefree_hil.control.contract import Pedals, Recipe, Setup, speed_of
from tunefree_hil.control.longitudinal import pid_preview
from tunefree_hil.control.longitudinal.pid import SPEED_LIMIT_MPS, STANDSTILL_MPS2, STATION_LIMIT_M, is_full_stop
from tunefree_hil.control.longitudinal.pid_preview import (
    PidPreviewParams,
    PidPreviewState,
    choose_pedal,
    estimate,
    feedback_errors,
    observe,
    put,
)
from tunefree_hil.control.mpc import plan as plans
from tunefree_hil.control.mpc.condensed import PlanWeights, condense, discretise, divide_horizon, tabulate
from tunefree_hil.control.mpc.settings import HORIZON, plan_settings, require_weights
from tunefree_hil.control.mpc.solver import MpcCriteria, require_osqp

LEAST_LAG_S = 0.02  # a faster driveline is modelled as this fast: two ticks
INPUT_SIZE_MPS2 = 10.0  # full braking
JERK_MPS3 = 10.0  # most of a command: twice what ISO 15622 allows an adaptive cruise control at low speed


class LongitudinalMpcParams(NamedTuple):
    """Planner and model; `base` has map, estimator, observer and pedals."""

    planner: plans.Planner
    change_s: np.ndarray  # seconds between the middles of two moves
    dead_ticks: int
    lag_share: float  # of the way to the command that the acceleration goes in one tick
    base: PidPreviewParams


class LongitudinalMpcState(NamedTuple):
    """The plan; feedback accelerations under way, oldest first; that which acts; last feedback and last command.

    base: estimates and pedal in use. Its integral and its feedback under way are not used.
    """

    plan: plans.PlanState
    under_way_mps2: tuple[float, ...]
    acting_mps2: float
    input_mps2: float
    accel_mps2: float
    base: PidPreviewState


class MotionEstimate(NamedTuple):
    """Speed and bias of the acceleration; the commanded acceleration that acts by now; disturbance; both errors."""

    speed_mps: float
    bias_mps2: float
    acting_mps2: float
    disturbance_mps2: float
    error_mps: float
    station_m: float


def make(setup: Setup, criteria: MpcCriteria | None = None) -> Block:
    """x = (Tracking, Measurement) -> Pedals."""
    require_osqp("longitudinal")
    values, delays, dt_s = setup.values, setup.delays, setup.dt_s
    require_weights(values, ("mpc.r_accel",), WEIGHTS)
    base = cast(PidPreviewParams, pid_preview.make(replace(setup, values={**values, "speed.predict": 0.0})).params)
    reach, dead_s = values["speed.predict"], delays.drive_dead_time_s + delays.bus_s
    dead_ticks, lag_s = round(reach * dead_s / dt_s), max(reach * base.lag_s, LEAST_LAG_S)
    settings = plan_settings(values)
    lengths = divide_horizon(settings.horizon_s, settings.step_s, dt_s)
    a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, -1.0 / lag_s]])
    weights = PlanWeights(
        (values["mpc.q_station"], values["mpc.q_speed"], 0.0),
        values["mpc.r_accel"],
        values["mpc.r_accel_rate"],
        settings.is_terminal_riccati,
    )
    model = discretise(a, np.array([0.0, 0.0, 1.0 / lag_s]), dt_s)
    table = tabulate((0.0,), [condense(model, weights, lengths, dead_ticks, dt_s)])
    planner = plans.make_planner(table, lengths, INPUT_SIZE_MPS2, criteria or MpcCriteria(), is_timed=setup.is_realtime)
    change_s = plans.middle_distances_s(lengths, dt_s)
    lag_share = 1.0 - math.exp(-dt_s / lag_s)
    return Block(init, step, LongitudinalMpcParams(planner, change_s, dead_ticks, lag_share, base), CONTROLLER.tunables)


def init(params: LongitudinalMpcParams, dt_s: float) -> LongitudinalMpcState:
    """Nothing under way, no plan."""
    plan = plans.first_plan(params.planner)
    under_way = (0.0,) * params.dead_ticks
    return LongitudinalMpcState(plan, under_way, 0.0, 0.0, 0.0, pid_preview.init(params.base, dt_s))


def step(
    params: LongitudinalMpcParams, state: LongitudinalMpcState, x: tuple[Tracking, Measurement], dt_s: float
) -> tuple[LongitudinalMpcState, Pedals]:
    """a_cmd = a_ref later + first move of the plan - disturbance; u = f_map(a_cmd, v)."""
    tracking, measurement = x
    base, before = params.base, state.base
    v = speed_of(measurement, base.chassis_speed)
    motion = estimate_motion(base, before, tracking, measurement, dt_s)
    planned_mps2 = tracking.preview_accel_mps2 - motion.disturbance_mps2
    low_mps2, high_mps2 = possible_accels(base, v)
    known = (
        clamp(motion.station_m, -STATION_LIMIT_M, STATION_LIMIT_M),
        clamp(motion.error_mps, -SPEED_LIMIT_MPS, SPEED_LIMIT_MPS),
        state.acting_mps2,
        *state.under_way_mps2,
        state.input_mps2,
    )
    bounds = plan_bounds(params, planned_mps2, state.accel_mps2, (low_mps2, high_mps2), dt_s)
    plan = plans.next_plan(params.planner, state.plan, 0.0, known, bounds)
    accel_mps2 = planned_mps2 + plans.move_now(params.planner, plan)
    stopping = is_full_stop(tracking)
    if stopping:
        accel_mps2 = min(accel_mps2, STANDSTILL_MPS2)
    accel_mps2 = clamp(accel_mps2, base.accel_low_mps2, base.accel_high_mps2)
    reference_mps2 = clamp(tracking.preview_accel_mps2, base.accel_low_mps2, base.accel_high_mps2)
    pedal, pedals = choose_pedal(base, before.pedal, v, (accel_mps2, reference_mps2), stopping)
    possible_mps2 = clamp(accel_mps2, low_mps2, high_mps2)
    command_place = put(before.command_mps2, before.command_place, possible_mps2)
    input_mps2 = possible_mps2 - planned_mps2
    under_way = (
        *state.under_way_mps2,
        0.0 if stopping else input_mps2,
    )  # the brake of a stopped vehicle changes nothing
    feedback_mps2 = state.acting_mps2 + params.lag_share * (under_way[0] - state.acting_mps2)
    new_base = PidPreviewState(
        0.0, before.feedback_mps2, 0, before.command_mps2, command_place, motion.speed_mps, motion.bias_mps2,
        motion.acting_mps2, motion.station_m, motion.disturbance_mps2, pedal,
    )  # fmt: skip
    return LongitudinalMpcState(plan, under_way[1:], feedback_mps2, input_mps2, possible_mps2, new_base), pedals


def estimate_motion(
    base: PidPreviewParams, before: PidPreviewState, tracking: Tracking, measurement: Measurement, dt_s: float
) -> MotionEstimate:
    """Estimator and observer of pid_preview.py, a tick on."""
    share = dt_s / (base.lag_s + dt_s)
    acting_mps2 = before.acting_mps2 + share * (float(before.command_mps2[before.command_place]) - before.acting_mps2)
    speed_mps, bias_mps2, seen_mps2 = estimate(base, before, measurement, acting_mps2, dt_s)
    disturbance_mps2 = observe(base, before, measurement.ins.speed_mps, seen_mps2 - acting_mps2, dt_s)
    error_mps, station_m = feedback_errors(base, before, tracking, measurement.ins.speed_mps - speed_mps, dt_s)
    return MotionEstimate(speed_mps, bias_mps2, acting_mps2, disturbance_mps2, error_mps, station_m)


def possible_accels(base: PidPreviewParams, speed_mps: float) -> tuple[float, float]:
    """(least, most) acceleration at a speed: the vehicle's bounds, and the ends of the map."""
    low_mps2 = max(base.accel_low_mps2, lookup(base.edges.low_mps2, speed_mps, 0.0))
    return low_mps2, max(min(base.accel_high_mps2, lookup(base.edges.high_mps2, speed_mps, 0.0)), low_mps2)


def plan_bounds(
    params: LongitudinalMpcParams,
    planned_mps2: float,
    accel_mps2: float,
    possible_mps2: tuple[float, float],
    dt_s: float,
) -> plans.PlanBounds:
    """Bounds of the feedback moves, such that feedback and plan keep to the bounds of acceleration and jerk.

    The plan's acceleration is that of the preview, over the whole horizon. accel_mps2: the last command.
    """
    reach = JERK_MPS3 * np.concatenate([[dt_s], params.change_s])
    low, high = plans.bound_totals(accel_mps2, possible_mps2, reach)
    return plans.PlanBounds(low - planned_mps2, high - planned_mps2, -reach[1:], reach[1:])


def has_failed(params: LongitudinalMpcParams, state: LongitudinalMpcState) -> bool:
    """Whether there was no plan for too long."""
    return plans.has_failed(params.planner, state.plan)


# Boxes: the gains are about sqrt(q / r_accel): on the station 0.01 to 3 per s2, on the speed 0.1 to 4 per s. Those of
# station.kp times speed.kp and of speed.kp (control/parameters.py) are as large, with r_accel at 1.
WEIGHTS = (
    Tunable("mpc.q_station", "1/m2", 1e-4, 10.0),
    Tunable("mpc.q_speed", "s2/m2", 0.01, 16.0),
    Tunable("mpc.r_accel", "s4/m2", 0.1, 10.0),
    # Low: the commands are smoothed over 0.01 s, a tick. High: over 1 s, as long as a comfortable change takes.
    Tunable("mpc.r_accel_rate", "s6/m2", 1e-4, 1.0),
)
DEFAULTS = {
    "mpc.q_station": 0.16,
    "mpc.q_speed": 3.2,
    "mpc.r_accel": 1.0,
    "mpc.r_accel_rate": 0.01,
    **HORIZON.defaults,
}
CONTROLLER = Recipe(
    make, WEIGHTS + HORIZON.tunables + pid_preview.OWN, defaults=DEFAULTS, has_failed=has_failed, is_kernel=False
)
