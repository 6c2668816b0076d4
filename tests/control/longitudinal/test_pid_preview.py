"""Longitudinal control with preview: off it is the plain one, prediction holds a delay, what is unknown is found."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.base.course import Tracking
from tunefree_hil.base.records import Ins, Measurement, Report
from tunefree_hil.control.calibration_map import from_triples
from tunefree_hil.control.contract import LoopDelays, Settings, Setup, VehicleConstants
from tunefree_hil.control.longitudinal import pid, pid_preview
from tunefree_hil.control.parameters import BASELINES

DT_S = 0.01
COAST_MPS2 = -0.4
# Both pedals at rest give the coasting drag, as in a map that was learned from logs.
MAP = from_triples([0.0, 0.0, 0.0, 0.0], [-5.0, COAST_MPS2 - 0.05, COAST_MPS2 + 0.05, 5.0], [-0.5, -0.15, 0.15, 0.8])
DELAYS = LoopDelays(drive_dead_time_s=0.1, drive_lag_s=0.1, bus_s=0.02)
OFF = {"speed.preview_s": 0.0, "speed.predict": 0.0, "speed.observer_radps": 0.0, "pedals.hysteresis_mps2": 0.0}


def make(part=pid_preview, **values):
    full = {**BASELINES["as_shipped"], **OFF, **{key.replace("__", "."): value for key, value in values.items()}}
    return part.make(Setup(full, VehicleConstants(), MAP, Settings(), DT_S, delays=DELAYS))


def seen(station=0.0, speed=0.0, accel=0.0, v=5.0, to_go=100.0, plan=5.0):
    tracking = Tracking(
        station_error_m=station,
        speed_error_mps=speed,
        preview_accel_mps2=accel,
        preview_speed_mps=plan,
        path_remaining_m=to_go,
    )
    return tracking, Measurement(Report(speed_mps=v), Ins(speed_mps=v))


def drive(block, seconds, *, delay_s=0.22, push_mps2=0.0, speed_error=0.5, v=8.0):
    """Speed errors and pedals of a mass that answers `delay_s` late; push_mps2 acts beside the demand."""
    state, line = block.init(block.params, DT_S), [0.0] * (round(delay_s / DT_S) + 1)
    station, answers = 0.0, []
    for _ in range(round(seconds / DT_S)):
        state, pedals = block.step(block.params, state, seen(station, speed_error, v=v - speed_error), DT_S)
        line = [*line[1:], pedals.accel_mps2]
        speed_error -= (line[0] + push_mps2) * DT_S
        station += speed_error * DT_S
        answers.append((speed_error, pedals))
    return answers


@given(st.floats(-1.0, 1.0), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(0.0, 20.0))
def test_off_it_demands_the_acceleration_of_the_plain_one(station, speed, accel, v):
    x = seen(station, speed, accel, v)
    plain, ours = make(pid), make()
    expected = plain.step(plain.params, plain.init(plain.params, DT_S), x, DT_S)[1].accel_mps2
    found = ours.step(ours.params, ours.init(ours.params, DT_S), x, DT_S)[1].accel_mps2
    assert found == pytest.approx(min(max(expected, -6.0), 2.0), abs=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.1, 10.0), st.floats(0.01, 1.0))
def test_prediction_holds_every_gain_of_the_published_box(kp, station_kp):
    block = make(speed__predict=1.0, speed__kp_high=kp, station__kp=station_kp, speed__ki_high=0.01)
    errors = [error for error, _ in drive(block, 60.0)]
    last = errors[-500:]
    assert max(last) - min(last) < 0.1


def test_without_prediction_high_gains_swing():
    errors = [error for error, _ in drive(make(speed__kp_high=9.0), 30.0)][-500:]
    assert max(errors) - min(errors) > 0.3


def test_the_observer_finds_a_grade_sooner_than_the_integral():
    with_observer = drive(make(speed__observer_radps=2.0, speed__predict=1.0), 6.0, push_mps2=-0.5, speed_error=0.0)
    without = drive(make(speed__predict=1.0), 6.0, push_mps2=-0.5, speed_error=0.0)
    squared = [math.fsum(error * error for error, _ in answers) for answers in (with_observer, without)]
    assert squared[0] < 0.5 * squared[1]


def test_the_observer_does_not_learn_from_a_standing_vehicle():
    block = make(speed__observer_radps=4.0)
    state = block.init(block.params, DT_S)
    for _ in range(1000):
        state, _ = block.step(block.params, state, seen(accel=1.0, v=0.0), DT_S)
    assert state.disturbance_mps2 == 0.0


def pedals_of(block, accels, v=10.0):
    state, found = block.init(block.params, DT_S), []
    for accel in accels:
        state, pedals = block.step(block.params, state, seen(accel=accel, v=v), DT_S)
        found.append((pedals.throttle_frac > 0.15, pedals.brake_frac > 0.15))
    return found


def test_coasting_drag_is_used_before_the_brake():
    throttle, brake = pedals_of(make(), [-0.2])[0]
    assert throttle and not brake


def test_never_both_pedals_and_no_alternation_within_the_hysteresis():
    wave = [COAST_MPS2 + 0.15 * math.sin(0.05 * k) for k in range(2000)]
    for hysteresis, expected in ((0.0, True), (0.3, False)):
        found = pedals_of(make(pedals__hysteresis_mps2=hysteresis), wave)
        assert not any(throttle and brake for throttle, brake in found)
        assert any(brake for _, brake in found) == expected


def test_a_full_stop_brakes_from_either_pedal():
    block = make(pedals__hysteresis_mps2=0.4)
    x = seen(accel=0.0, v=0.1, plan=0.0, to_go=0.1)
    pedals = block.step(block.params, block.init(block.params, DT_S), x, DT_S)[1]
    assert pedals.accel_mps2 <= -0.3 and pedals.throttle_frac == 0.15
