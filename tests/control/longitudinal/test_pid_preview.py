"""Longitudinal control with preview: off it is the plain one, prediction holds a delay, what is unknown is found."""

from __future__ import annotations

import itertools
import math
import random
import statistics
from typing import Any

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
# The first 30 % of the brake do nothing, as in a map that was learned on drums with a worn linkage.
DEAD_ZONE = from_triples([0.0] * 4, [-5.0, COAST_MPS2 - 0.01, COAST_MPS2, 1.0], [-0.5, -0.3, 0.15, 0.8])
OFF = {
    "speed.preview_s": 0.0,
    "speed.predict": 0.0,
    "speed.observer_radps": 0.0,
    "speed.filter_s": 0.0,
    "pedals.hysteresis_mps2": 0.0,
}


def make(part: Any = pid_preview, calibration: Any = MAP, absent: Any = frozenset(), **values):
    full = {**BASELINES["as_shipped"], **OFF, **{key.replace("__", "."): value for key, value in values.items()}}
    return part.make(Setup(full, VehicleConstants(), calibration, Settings(), DT_S, absent, delays=DELAYS))


def seen(station=0.0, speed=0.0, accel=0.0, v=5.0, to_go=100.0, plan=5.0, felt=0.0):
    tracking = Tracking(
        station_error_m=station,
        speed_error_mps=speed,
        preview_accel_mps2=accel,
        preview_speed_mps=plan,
        path_remaining_m=to_go,
    )
    return tracking, Measurement(Report(speed_mps=v), Ins(speed_mps=v, accel_mps2=felt))


def drive(block, seconds, *, delay_s=0.22, push_mps2=0.0, speed_error=0.5, v=8.0):
    """Speed errors and pedals of a mass that answers `delay_s` late; push_mps2 acts beside the demand."""
    state, line = block.init(block.params, DT_S), [0.0] * (round(delay_s / DT_S) + 1)
    station, answers = 0.0, []
    for _ in range(round(seconds / DT_S)):
        x = seen(station, speed_error, v=v - speed_error, felt=line[0] + push_mps2)
        state, pedals = block.step(block.params, state, x, DT_S)
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


@pytest.mark.parametrize("absent", [frozenset(), frozenset({"ins.accel_mps2"})])
def test_the_observer_finds_a_grade_sooner_than_the_integral(absent):
    block = make(absent=absent, speed__observer_radps=2.0, speed__predict=1.0)
    with_observer = drive(block, 6.0, push_mps2=-0.5, speed_error=0.0)
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


def test_at_full_pedal_the_observer_does_not_learn_what_the_pedal_lacks():
    most_mps2 = 1.0  # of DEAD_ZONE, which is asked for 2 m/s2
    block = make(calibration=DEAD_ZONE, speed__observer_radps=1.0)
    state = block.init(block.params, DT_S)
    for k in range(1000):
        x = seen(accel=2.0, v=1.0 + most_mps2 * k * DT_S, felt=most_mps2)
        state, _ = block.step(block.params, state, x, DT_S)
    assert state.disturbance_mps2 == pytest.approx(0.0, abs=0.05)


def noisy(block, seed, seconds=20.0, accel=COAST_MPS2):
    """Pedals of a drive at the edge of the brake, with the sensors' noise and nothing else to correct."""
    scatter, state, found = random.Random(seed).gauss, block.init(block.params, DT_S), []
    for _ in range(round(seconds / DT_S)):
        noise = scatter(0.0, 0.014)
        x = seen(scatter(0.0, 0.009), -noise, accel, v=10.0 + noise, felt=scatter(0.0, 0.05))
        state, pedals = block.step(block.params, state, x, DT_S)
        found.append(pedals)
    return found


def switches(pedals):
    braking = [pedal.brake_frac > 0.16 for pedal in pedals]
    return sum(now != before for before, now in itertools.pairwise(braking))


NOISE = {"station__kp": 0.6, "speed__kp_high": 3.0, "speed__ki_high": 0.0}
CALM = {**NOISE, "speed__filter_s": 0.2, "pedals__hysteresis_mps2": 0.15}


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.floats(-0.05, 0.05))
def test_noise_does_not_make_the_brake_flip(seed, beside):
    accel = COAST_MPS2 + beside
    assert switches(noisy(make(calibration=DEAD_ZONE, **CALM), seed, accel=accel)) == 0
    assert switches(noisy(make(calibration=DEAD_ZONE, **NOISE), seed, accel=accel)) > 100


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32), st.floats(0.0, 0.1))
def test_a_brake_that_is_in_use_stays_at_its_edge(seed, above):
    block = make(calibration=DEAD_ZONE, **CALM)
    state = block.init(block.params, DT_S)
    for _ in range(50):  # on the brake
        state, _ = block.step(block.params, state, seen(accel=-2.0, v=10.0), DT_S)
    scatter, found = random.Random(seed).gauss, []
    for _ in range(1000):
        noise = scatter(0.0, 0.014)
        x = seen(0.0, -noise, COAST_MPS2 + above, v=10.0 + noise, felt=scatter(0.0, 0.05))
        state, pedals = block.step(block.params, state, x, DT_S)
        found.append(pedals)
    assert switches(found) == 0 and min(pedal.brake_frac for pedal in found) > 0.29


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32))
def test_the_filter_takes_the_noise_from_the_throttle(seed):
    scatter = [
        statistics.pstdev(pedals.throttle_frac for pedals in noisy(make(speed__filter_s=value), seed, accel=0.3)[100:])
        for value in (0.0, 0.2)
    ]
    assert 0.0 < scatter[1] < 0.5 * scatter[0]


@pytest.mark.parametrize("slope_mps2", [0.0, 0.5])  # that the accelerometer sees beside the acceleration
@pytest.mark.parametrize("pace_mps2", [-1.5, 1.5])
def test_the_filter_does_not_lag_a_steady_acceleration(slope_mps2, pace_mps2):
    block, plain = make(speed__filter_s=0.2), make()
    state, other = block.init(block.params, DT_S), plain.init(plain.params, DT_S)
    for k in range(300):
        v = 10.0 + pace_mps2 * k * DT_S
        x = seen(0.01 * k, 0.3, pace_mps2, v=v, felt=pace_mps2 + slope_mps2)
        state, pedals = block.step(block.params, state, x, DT_S)
        other, expected = plain.step(plain.params, other, x, DT_S)
    assert state.speed_mps == pytest.approx(v, abs=1e-3)
    assert pedals.accel_mps2 == pytest.approx(expected.accel_mps2, abs=0.01)


def test_a_replan_is_taken_at_once():
    block = make(speed__filter_s=0.2)
    state = block.init(block.params, DT_S)
    for station in (0.0, 0.0, 2.0):
        state, _ = block.step(block.params, state, seen(station), DT_S)
    assert state.station_m == 2.0


# Learned on the motorway: flat between 45 and 60 % of the throttle, where the drive is near its power limit.
FLAT = from_triples([28.0] * 6, [-5.0, -0.45, COAST_MPS2, 0.5, 0.55, 0.9], [-0.5, -0.15, 0.15, 0.45, 0.60, 0.70])
FLAT_SLOPE = (0.70 - 0.15) / (0.9 - COAST_MPS2)


def throttle_frac(planned_mps2: float, speed_error_mps: float) -> float:
    block = make(calibration=FLAT, station__kp=0.0, speed__kp_high=1.0, speed__ki_high=0.0)
    x = seen(speed=speed_error_mps, accel=planned_mps2, v=28.0, plan=28.0)
    return block.step(block.params, block.init(block.params, DT_S), x, DT_S)[1].throttle_frac


@pytest.mark.parametrize("feedback_mps2", [-0.1, -0.03, 0.04, 0.1])
def test_feedback_does_not_gain_where_the_map_is_flat(feedback_mps2):
    planned_frac = throttle_frac(0.52, 0.0)
    assert planned_frac == pytest.approx(0.51)  # the plan goes by the map
    moved = throttle_frac(0.52, feedback_mps2) - planned_frac
    most = pid_preview.SLOPE_FACTOR * FLAT_SLOPE * abs(feedback_mps2)
    assert 0.0 < math.copysign(1.0, feedback_mps2) * moved <= most + 1e-12


def test_feedback_goes_by_the_map_where_that_is_not_flat():
    assert throttle_frac(0.1, 0.1) == pytest.approx(0.15 + 0.3 * 0.6 / 0.9)
