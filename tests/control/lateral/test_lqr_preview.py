"""Lateral LQR with preview: on its own model it tracks a changing curvature without error, and holds a dead time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.base.course import Tracking
from tunefree_hil.base.records import Ins, Measurement, Report
from tunefree_hil.control.contract import LoopDelays, Settings, Setup, VehicleConstants
from tunefree_hil.control.lateral import lqr, lqr_preview
from tunefree_hil.control.parameters import BASELINES
from tunefree_hil.control.steering_map import data_sheet_map

DT_S = 0.01
CAR = VehicleConstants(front_stiffness_n_per_rad=115_000.0, rear_stiffness_n_per_rad=200_000.0)
DELAYS = LoopDelays(steer_dead_time_s=0.1, steer_lag_s=0.07, bus_s=0.02)
FILTER_S = 0.0225  # of the low-pass behind the part, which the part counts in
OFF = {"steer.preview": 0.0, "steer.predict": 0.0, "steer.integral_1ps": 0.0}


def make(part=lqr_preview, delays=DELAYS, steering=None, **values):
    full = {**BASELINES["as_shipped"], **OFF, **{key.replace("__", "."): value for key, value in values.items()}}
    return part.make(Setup(full, CAR, None, Settings(), DT_S, steering=steering or data_sheet_map(CAR), delays=delays))


def drive(block, speed_mps, curvature, seconds, *, preview_s=0.0, dead_s=0.0, lag_s=0.0, error_m=0.0, push_rad=0.0):
    """Lateral errors of the single-track error model (Rajamani 2.5) behind a dead time and a lag, RK4 at 1 ms.

    push_rad: a road-wheel angle that the map does not know.
    """
    car, v = CAR, speed_mps
    cf, cr, lf, lr = car.front_stiffness_n_per_rad, car.rear_stiffness_n_per_rad, car.front_axle_m, car.rear_axle_m
    m, inertia = car.mass_kg, car.yaw_inertia_kgm2
    turning, damping = lr * cr - lf * cf, lf * lf * cf + lr * lr * cr

    def slope(x, delta, kappa):
        y_rate, theta, theta_rate = x[1], x[2], x[3]
        yaw = theta_rate + v * kappa
        accel = -(cf + cr) / (m * v) * y_rate + (cf + cr) / m * theta + turning / (m * v) * yaw + cf / m * delta
        accel -= v * v * kappa
        spin = turning / (inertia * v) * y_rate - turning / inertia * theta - damping / (inertia * v) * yaw
        return np.array([y_rate, accel, theta_rate, spin + lf * cf / inertia * delta])

    x, state = np.array([error_m, 0.0, 0.0, 0.0]), block.init(block.params, DT_S)
    line, wheel, errors = [0.0] * (round(dead_s / DT_S) + 1), 0.0, []
    for k in range(round(seconds / DT_S)):
        t = k * DT_S
        tracking = Tracking(
            lateral_error_m=float(x[0]),
            lateral_error_rate_mps=v * math.sin(float(x[2])),
            heading_error_rad=float(x[2]),
            heading_error_rate_radps=float(x[3]),
            ref_curvature_1pm=curvature(t),
            preview_curvature_1pm=curvature(t + preview_s),
        )
        sight = (tracking, Measurement(Report(speed_mps=v), Ins(speed_mps=v)))
        state, demand_rad = block.step(block.params, state, sight, DT_S)
        line = [*line[1:], demand_rad / CAR.steer_ratio]
        for i in range(10):
            wheel += 0.001 / max(lag_s, 0.001) * (line[0] - wheel)
            kappa = curvature(t + 0.001 * i)
            turn_rate = (curvature(t + 0.001 * (i + 1)) - kappa) / 0.001 * v
            x = x + 0.001 * slope(x + 0.0005 * slope(x, wheel + push_rad, kappa), wheel + push_rad, kappa)
            x[3] -= 0.001 * turn_rate  # the heading error's rate is against the path's
        errors.append(float(x[0]))
    return np.array(errors)


def bend(t):
    """0.6 m/s2 up to 3 m/s2 at 12 m/s within a second, and back."""
    return 0.02 * 0.5 * (1.0 - math.cos(math.pi * min(max(t - 1.0, 0.0), 1.0))) * (1.0 if t < 5.0 else 0.0)


@pytest.mark.parametrize("speed_mps", [4.0, 12.0, 25.0])
def test_the_centre_of_mass_stays_on_a_path_of_changing_curvature(speed_mps):
    scale = min(1.0, 144.0 / speed_mps / speed_mps)
    errors = drive(make(), speed_mps, lambda t: scale * bend(t), 4.5)
    plain = drive(make(lqr), speed_mps, lambda t: scale * bend(t), 4.5)
    assert np.abs(errors).max() < 0.004
    assert np.abs(plain).max() > 2.0 * np.abs(errors).max()


def test_preview_makes_up_for_dead_time_and_lag():
    late = DELAYS.steer_dead_time_s + DELAYS.steer_lag_s + DELAYS.bus_s
    behind = {"dead_s": 0.12, "lag_s": 0.07}
    with_preview = drive(make(steer__preview=1.0), 12.0, bend, 4.5, preview_s=late, **behind)
    without = drive(make(), 12.0, bend, 4.5, **behind)
    assert np.abs(with_preview).max() < 0.15 * np.abs(without).max()


@settings(max_examples=12, deadline=None)
@given(st.sampled_from([3.0, 8.0, 16.0, 28.0]), st.floats(0.05, 1.0), st.floats(0.05, 1.0))
def test_prediction_holds_gains_that_the_dead_time_would_make_swing(speed_mps, q1, q3):
    """Within the published box no set swings on its own model, where the plain form does for many (see below)."""
    block = make(steer__predict=1.0, lqr__q1=q1, lqr__q3=q3)
    errors = drive(block, speed_mps, lambda t: 0.0, 12.0, dead_s=0.12 + FILTER_S, lag_s=0.07, error_m=0.2)
    assert np.abs(errors[-300:]).max() < 0.02
    assert np.abs(errors).max() < 0.3


def test_without_prediction_the_same_gains_swing():
    errors = drive(make(lqr__q1=1.0), 16.0, lambda t: 0.0, 12.0, dead_s=0.12 + FILTER_S, lag_s=0.07, error_m=0.2)
    assert np.abs(errors[-300:]).max() > 0.2


def test_the_integral_takes_out_what_the_map_does_not_know():
    push = {"push_rad": 0.004, "dead_s": 0.12, "lag_s": 0.07}
    with_integral = drive(make(steer__predict=1.0, steer__integral_1ps=0.1), 15.0, lambda t: 0.0, 40.0, **push)
    without = drive(make(steer__predict=1.0), 15.0, lambda t: 0.0, 40.0, **push)
    assert abs(without[-1]) > 0.03
    assert abs(with_integral[-1]) < 0.1 * abs(without[-1])


def test_the_integral_stands_far_from_the_path_and_stays_within_its_bound():
    block = make(steer__integral_1ps=0.1)
    sight = Measurement(Report(speed_mps=10.0), Ins(speed_mps=10.0))
    zero = {"lateral_error_rate_mps": 0.0, "heading_error_rad": 0.0, "heading_error_rate_radps": 0.0}
    zero |= {"ref_curvature_1pm": 0.0, "preview_curvature_1pm": 0.0}
    for error_m, expected in ((0.4, 0.0), (0.25, -lqr_preview.INTEGRAL_LIMIT_RAD)):
        state = block.init(block.params, DT_S)
        for _ in range(20_000):
            state, _ = block.step(block.params, state, (Tracking(lateral_error_m=error_m, **zero), sight), DT_S)
        assert state.integral_rad == pytest.approx(expected)


def test_without_its_options_and_lag_the_gains_are_the_plain_ones():
    """At 28 speeds; the lag of two ticks that remains and the way of discretising change them by a few percent."""
    block, rows = make(), lqr.gain_rows(lqr.NODES_MPS, (0.05, 0.0, 1.0, 0.0), CAR, DT_S, shipped=False)
    for k, row in enumerate(rows):
        if lqr.NODES_MPS[k] >= 1.0:
            found = [block.params.gains[k * block.params.width + i] for i in (0, 2)]
            assert found == pytest.approx([row[0], row[2]], rel=0.08)
