"""Lateral MPC: without bounds it is the LQR with preview, with them it keeps to them and prepares for them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tunefree_hil.base.course import Tracking
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import Ins, Measurement, Report
from tunefree_hil.control import cascade
from tunefree_hil.control.build import PartNames, build, own_values
from tunefree_hil.control.cascade import ERROR_NO_SOLUTION, STOP_BRAKE_FRAC, ControllerInput
from tunefree_hil.control.contract import LoopDelays, Settings, Setup, VehicleConstants
from tunefree_hil.control.lateral import lqr_preview, mpc
from tunefree_hil.control.limits import steer_bound
from tunefree_hil.control.mpc.solver import MpcCriteria
from tunefree_hil.control.parameters import BASELINES, study_values
from tunefree_hil.control.path import make_path
from tunefree_hil.control.steering_map import data_sheet_map

DT_S = 0.01
CAR = VehicleConstants(front_stiffness_n_per_rad=115_000.0, rear_stiffness_n_per_rad=200_000.0)
DELAYS = LoopDelays(steer_dead_time_s=0.1, steer_lag_s=0.07, bus_s=0.02)
NAMES = PartNames(lateral="mpc", longitudinal="mpc")
WEIGHTS = {f"mpc.{one}": value for one, value in (("q_lateral", 0.05), ("q_heading", 1.0), ("r_steer_rate", 0.0))}


def make(kit: Any, part: Any = mpc, vehicle: VehicleConstants = CAR, criteria: Any = None, **changes: float) -> Any:
    """The Block of a part on a straight path; changes: values with `__` for the dot."""
    values = {**BASELINES["as_shipped"], **own_values(NAMES), **WEIGHTS, "steer.integral_1ps": 0.0}
    values |= {name.replace("__", "."): value for name, value in changes.items()}
    path = make_path(kit.course(20.0, lambda t: 10.0))
    setup = Setup(values, vehicle, None, Settings(), DT_S, steering=data_sheet_map(vehicle), delays=DELAYS, path=path)
    return part.make(setup, criteria) if part is mpc else part.make(setup)


def sight(
    v: float = 10.0, lateral: float = 0.0, heading: float = 0.0, ahead: float = 0.0
) -> tuple[Tracking, Measurement]:
    """Errors at a speed, straight on at station 0; ahead: curvature at the lead time."""
    tracking = Tracking(
        lateral_error_m=lateral,
        lateral_error_rate_mps=v * math.sin(heading),
        heading_error_rad=heading,
        heading_error_rate_radps=0.0,
        ref_curvature_1pm=0.0,
        preview_curvature_1pm=ahead,
        preview_accel_mps2=0.0,
    )
    return tracking, Measurement(Report(speed_mps=v), Ins(0.0, lateral, heading, v, 0.0, 0.0))


@pytest.mark.parametrize("speed_mps", [1.0, 5.0, 12.0, 25.0])
def test_without_bounds_it_is_the_lqr_with_preview(kit: Any, speed_mps: float) -> None:
    """At the speeds where Apollo's ratios of both are known; the weights are chosen so that they are the same."""
    ratios = {1.0: (1, 1, 1), 5.0: (0.9, 0.9, 1), 12.0: (0.2 / 0.36, 0.4 / 0.46, 1.1), 25.0: (0.5, 0.1 / 0.35, 1.55)}
    lateral, heading, steer = ratios[speed_mps]
    weights = {"mpc__q_lateral": 0.05 * lateral, "mpc__q_heading": heading, "mpc__r_steer": 1.0 / steer}
    blocks = [make(kit, **weights), make(kit, lqr_preview)]
    demands = []
    for block in blocks:
        state, demand = block.init(block.params, DT_S), []
        for k in range(60):
            state, rad = block.step(block.params, state, sight(speed_mps, 0.002, 0.0001 * k), DT_S)
            demand.append(rad)
        demands.append(demand)
    assert demands[0] == pytest.approx(demands[1], rel=0.06)


def test_the_commands_keep_to_angle_and_rate(kit: Any) -> None:
    block = make(kit)
    state, last_rad, counts = block.init(block.params, DT_S), 0.0, []
    bound_rad = steer_bound(block.params.bound, 20.0)
    for k in range(300):
        error_m = 3.0 if k < 150 else -3.0
        state, rad = block.step(block.params, state, sight(20.0, error_m, 0.2 * math.copysign(1.0, error_m)), DT_S)
        assert abs(rad - last_rad) <= CAR.steer_rate_radps * DT_S + 1e-9
        assert abs(rad) <= bound_rad + 1e-9
        last_rad = rad
        counts.append(state.plan.counts)
    assert counts[-1].failed == 0 and counts[-1].bounded > 100
    assert abs(last_rad) == pytest.approx(bound_rad, rel=1e-3)


def test_a_bound_that_falls_with_the_speed_is_gone_back_to(kit: Any) -> None:
    """At 3 m/s the wheel may be anywhere, at 25 m/s not: no plan is impossible on the way."""
    block = make(kit)
    state = block.init(block.params, DT_S)
    for k in range(200):
        v = 3.0 if k < 60 else 25.0
        state, rad = block.step(block.params, state, sight(v, 1.5, 0.5), DT_S)
    assert state.plan.counts.failed == 0
    assert abs(rad) <= steer_bound(block.params.bound, 25.0) + 1e-9


def test_a_bend_that_the_rate_would_cut_short_is_prepared_for(kit: Any) -> None:
    """A slow steering begins before the bend; the LQR begins at the lead time."""
    slow = CAR._replace(steer_rate_radps=0.6)
    bend = make_path(kit.course(20.0, lambda t: 10.0, lambda station_m: 0.03 if station_m > 9.0 else 0.0))
    block = make(kit, vehicle=slow)
    straight = block._replace(params=block.params._replace(path=make_path(kit.course(20.0, lambda t: 10.0))))
    curved = block._replace(params=block.params._replace(path=bend))
    demands = []
    for one in (curved, straight):
        state, demand = one.init(one.params, DT_S), 0.0
        for _ in range(5):
            state, demand = one.step(one.params, state, sight(), DT_S)
        demands.append(demand)
    assert demands[0] > 0.01 and demands[1] == pytest.approx(0.0, abs=1e-9)


def drive(kit: Any, block: Any, course: Any, car: Any) -> list[Any]:
    """Decisions of a drive with perfect actuators."""
    state, decisions = block.init(block.params, DT_S), []
    for k in range(course.ticks):
        state, decision = block.step(block.params, state, ControllerInput(k, car.measurement()), DT_S)
        decisions.append(decision)
        car = car.moved(decision.command.steer_rad / 16.0, decision.command.accel_mps2)
    return decisions


def bend(station_m: float) -> float:
    return 0.06 * math.sin(station_m / 8.0) if station_m > 10.0 else 0.0


def controller(kit: Any, course: Any, **changes: float) -> Any:
    """Both parts in the whole controller, without known delays."""
    values = {**study_values(), **own_values(NAMES), "mrac.enable": 0.0, "steer.predict": 0.0, "steer.preview": 0.0}
    values |= {"speed.predict": 0.0} | {name.replace("__", "."): value for name, value in changes.items()}
    return build(values, VehicleConstants(), kit.linear_map(), course, names=NAMES)


@pytest.mark.parametrize(
    "changes",
    [{}, {"mpc__horizon_s": 0.1}, {"mpc__step_s": 0.05}, {"mpc__horizon_s": 2.0, "mpc__terminal": 0.0}],
    ids=["default", "short", "coarse", "without cost to go"],
)
def test_both_parts_drive_from_start_to_stop(kit: Any, changes: dict[str, float]) -> None:
    course = kit.course(17.0, lambda t: min(5.0, 1.5 * t) if t < 10.0 else max(0.0, 15.0 - t), bend)
    decisions = drive(kit, controller(kit, course, **changes), course, kit.car(0.0, 0.2, 0.0, 0.0))
    assert not any(decision.error_code for decision in decisions)
    assert not any(decision.tracking.replan for decision in decisions)
    assert max(abs(decision.tracking.lateral_error_m) for decision in decisions[600:]) < 0.15
    last = decisions[-1].tracking
    assert last.speed_error_mps == pytest.approx(0.0, abs=1e-6) and abs(last.station_error_m) < 0.4
    assert decisions[-1].command.brake_frac > 0.15


def test_without_a_solution_for_too_long_the_vehicle_is_braked(kit: Any) -> None:
    course = kit.course(3.0, lambda t: 5.0)
    block = controller(kit, course)
    lateral = block.params.lateral
    planner = lateral.planner._replace(criteria=MpcCriteria(max_failed_ticks=4))
    impossible = block.params._replace(lateral=lateral._replace(planner=planner, rate_radps=-1.0))
    decisions = drive(kit, block._replace(params=impossible), course, kit.car(0.0, 0.2, 0.0, 5.0))
    codes = [decision.error_code for decision in decisions[:5]]
    assert codes == [0.0, 0.0, 0.0, ERROR_NO_SOLUTION, ERROR_NO_SOLUTION]
    assert decisions[3].command.brake_frac == STOP_BRAKE_FRAC


def test_parts_that_cannot_fail_are_not_wrapped(kit: Any) -> None:
    course = kit.course(1.0, lambda t: 5.0)
    plain = build(BASELINES["as_shipped"], VehicleConstants(), kit.linear_map(), course)
    assert plain.step.__qualname__.startswith(cascade.assemble.__name__)


@pytest.mark.parametrize(
    ("name", "value"), [("mpc.r_steer", 0.0), ("mpc.q_lateral", -1.0), ("mpc.horizon_s", 0.0), ("mpc.step_s", 99.0)]
)
def test_a_weight_or_a_time_that_is_not_possible_is_named(kit: Any, name: str, value: float) -> None:
    with pytest.raises(InputError) as caught:
        make(kit, **{name.replace(".", "__"): value})
    assert (caught.value.code, caught.value.key) == ("bad_parameter", name) and caught.value.hint


def test_a_state_may_be_stepped_from_again(kit: Any) -> None:
    """Nothing of a solve is hidden in the part."""
    block = make(kit)
    state = block.init(block.params, DT_S)
    for k in range(30):
        state, _ = block.step(block.params, state, sight(15.0, 2.0 - 0.05 * k, 0.3), DT_S)
    first = block.step(block.params, state, sight(15.0, 1.0, 0.3), DT_S)
    block.step(block.params, block.init(block.params, DT_S), sight(3.0, -1.0, 0.1), DT_S)
    again = block.step(block.params, state, sight(15.0, 1.0, 0.3), DT_S)
    assert first[0].plan.counts.most_iterations > 0
    assert first[1] == again[1] and np.array_equal(first[0].plan.moves, again[0].plan.moves)
