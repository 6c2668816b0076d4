"""Longitudinal PID: eq. 2, limits, anti-windup, gain switch, standstill, pedals."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.course import Tracking
from tunefree_hil.base.records import Ins, Measurement, Report
from tunefree_hil.control.calibration_map import from_triples
from tunefree_hil.control.contract import Settings, Setup, VehicleConstants
from tunefree_hil.control.longitudinal import pid
from tunefree_hil.control.parameters import BASELINES

DT_S = 0.01
MAP = from_triples([0.0, 0.0, 0.0, 0.0], [-5.0, -1e-6, 0.0, 5.0], [-0.5, -0.15, 0.15, 0.8])


def make(calibration=MAP, absent=(), **values):
    full = {**BASELINES["as_shipped"], **{key.replace("__", "."): value for key, value in values.items()}}
    return pid.make(Setup(full, VehicleConstants(), calibration, Settings(), DT_S, frozenset(absent)))


def seen(station=0.0, speed=0.0, accel=0.0, to_go=100.0, v=5.0, plan=5.0):
    tracking = Tracking(
        station_error_m=station,
        speed_error_mps=speed,
        preview_accel_mps2=accel,
        preview_speed_mps=plan,
        path_remaining_m=to_go,
    )
    return tracking, Measurement(Report(speed_mps=v), Ins(speed_mps=v))


def run(block, inputs):
    state, answers = block.init(block.params, DT_S), []
    for x in inputs:
        state, pedals = block.step(block.params, state, x, DT_S)
        answers.append((pedals, state))
    return answers


def test_equation_2_by_hand():
    pedals, state = run(make(), [seen(station=0.5, speed=0.3, accel=0.4)])[0]
    error = 0.3 + 0.2 * 0.5
    assert state.integral_mps2 == pytest.approx(0.3 * error * DT_S)
    assert pedals.accel_mps2 == pytest.approx(1.0 * error + 0.3 * error * DT_S + 0.4)
    assert pedals.throttle_frac == pytest.approx(0.15 + 0.65 * pedals.accel_mps2 / 5.0)
    assert pedals.brake_frac == 0.15


def test_gain_set_switches_hard_at_3_and_the_integral_does_not_jump():
    block = make(speed__kp_low=2.0, speed__kp_high=1.0, speed__ki_low=0.9, speed__ki_high=0.1)
    answers = run(block, [seen(speed=0.5, v=3.0)] * 10 + [seen(speed=0.5, v=3.001)])
    assert answers[9][1].integral_mps2 == pytest.approx(10 * 0.9 * 0.5 * DT_S)
    assert answers[10][1].integral_mps2 - answers[9][1].integral_mps2 == pytest.approx(0.1 * 0.5 * DT_S)
    assert answers[9][0].accel_mps2 - answers[10][0].accel_mps2 == pytest.approx(0.5, abs=0.01)


def test_station_and_speed_errors_are_limited():
    block = make(station__kp=0.2, speed__ki_high=0.01)
    one, other = run(block, [seen(station=2.0)])[0][0], run(block, [seen(station=50.0)])[0][0]
    assert one == other
    assert run(block, [seen(speed=-30.0)])[0][0].accel_mps2 == pytest.approx(-2.0, abs=1e-3)


def test_integral_is_clamped_and_leaves_the_clamp_at_once():
    answers = run(make(speed__ki_high=1.0), [seen(speed=1.5)] * 500 + [seen(speed=-0.5)] * 3)
    assert answers[499][1].integral_mps2 == pytest.approx(0.3)
    assert [state.integral_mps2 for _, state in answers[500:]] == pytest.approx([0.295, 0.29, 0.285])


@pytest.mark.parametrize(
    ("x", "stopped"),
    [
        (seen(plan=0.2, accel=0.01), True),
        (seen(plan=0.21, accel=0.01), False),
        (seen(plan=0.1, accel=0.02), False),
        (seen(to_go=0.29), True),
        (seen(to_go=-0.29), True),
        (seen(to_go=0.31), False),
        (seen(to_go=-0.31), False),
    ],
)
def test_standstill_rule(x, stopped):
    assert pid.is_full_stop(x[0]) is stopped


def test_standstill_holds_the_brake_and_forgets_the_integral():
    answers = run(make(), [seen(speed=1.0)] * 100 + [seen(speed=0.5, plan=0.0, v=0.0)])
    pedals, state = answers[-1]
    assert state.integral_mps2 == 0.0
    assert pedals.accel_mps2 == -0.3
    assert pedals.brake_frac > 0.15
    harder, _ = run(make(), [seen(speed=-2.0, plan=0.0, v=1.0)])[0]
    assert harder.accel_mps2 == pytest.approx(-4.0, abs=0.01)


def test_pedal_is_chosen_by_the_sign_of_the_acceleration():
    # At this speed coasting gives -0.27: a slight deceleration would be a throttle position in the map.
    coasting = from_triples([10.0] * 4, [-3.0, -0.28, -0.27, 2.0], [-0.3, -0.15, 0.165, 0.6])
    block = make(coasting)
    gentle = pid.actuate(block.params, 10.0, -0.1)
    assert (gentle.throttle_frac, gentle.brake_frac) == (0.15, 0.15)
    assert pid.actuate(block.params, 10.0, -1.0).brake_frac > 0.15
    # Creep: a small acceleration would be a brake position.
    creep = from_triples([0.0] * 4, [-3.0, 0.3, 0.31, 2.0], [-0.3, -0.15, 0.165, 0.6])
    rolling = pid.actuate(make(creep).params, 0.0, 0.1)
    assert (rolling.throttle_frac, rolling.brake_frac) == (0.15, 0.15)


@given(st.floats(-20.0, 20.0), st.floats(0.0, 40.0))
def test_never_both_pedals_and_never_below_rest(accel, speed):
    pedals = pid.actuate(make().params, speed, accel)
    assert pedals.throttle_frac >= 0.15 and pedals.brake_frac >= 0.15
    assert pedals.throttle_frac == 0.15 or pedals.brake_frac == 0.15


def test_ins_speed_stands_in_where_the_chassis_reports_none():
    tracking, measurement = seen(speed=0.2, v=5.0)
    without = (tracking, measurement._replace(report=Report()))
    block = make(absent=["report.speed_mps"])
    assert run(block, [without])[0][0] == run(make(), [(tracking, measurement)])[0][0]
