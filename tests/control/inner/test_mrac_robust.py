"""Robust MRAC: with a dead time it stays calm where the plain law swings, it learns, leaks back, keeps its bounds."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.control.contract import LoopDelays, Settings, Setup, VehicleConstants
from tunefree_hil.control.inner import mrac, mrac_robust
from tunefree_hil.control.parameters import BASELINES

DT_S = 0.01
MKZ = VehicleConstants(lateral_accel_mps2=1e6)
LIMIT_RAD = MKZ.steer_limit_rad
DELAYS = LoopDelays(steer_dead_time_s=0.1, steer_lag_s=0.07, bus_s=0.02)


def make(part=mrac_robust, **values):
    full = {**BASELINES["mrac_on"], "mrac.clamp_s": 0.01, "mrac.leak_1ps": 0.0, "mrac.reach": 1.0}
    full |= {f"mrac.{key}": value for key, value in values.items()}
    return part.make(Setup(full, MKZ, None, Settings(), DT_S, delays=DELAYS))


def drive(block, seconds, command, *, dead_s=0.12, lag_s=0.07, gain=1.0):
    """(angles in percent, last state) of a first-order actuator behind a dead time."""
    state, line, angle, angles = block.init(block.params, DT_S), [0.0] * (round(dead_s / DT_S) + 1), 0.0, []
    for k in range(round(seconds / DT_S)):
        x = (command(k * DT_S) / 100.0 * LIMIT_RAD, angle / 100.0 * LIMIT_RAD, 5.0)
        state, answer = block.step(block.params, state, x, DT_S)
        line = [*line[1:], answer.steer_rad / LIMIT_RAD * 100.0]
        angle += DT_S / (lag_s + DT_S) * (gain * line[0] - angle)
        angles.append(angle)
    return angles, state


def square(t):
    return 20.0 if (0.25 * t) % 1.0 < 0.5 else -20.0


def test_off_it_passes_the_demand_on():
    block = make(enable=0.0)
    assert block.step(block.params, block.init(block.params, DT_S), (0.3, 0.1, 5.0), DT_S)[1] == (0.3, 0.0)


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-4, 0.1), st.floats(0.05, 0.26), st.floats(0.5, 2.0), st.floats(0.03, 0.2))
def test_in_the_published_box_it_neither_runs_away_nor_swings(p, t_ref_s, lag_factor, dead_s):
    block = make(p=p, t_ref_s=t_ref_s, leak_1ps=0.05, reach=0.5)
    angles, _ = drive(block, 40.0, square, lag_s=0.07 * lag_factor, dead_s=dead_s)
    assert max(abs(angle) for angle in angles) < 60.0
    settled = angles[-60:]  # 1.4 s after the last step of the square wave
    assert max(settled) - min(settled) < 6.0


def test_the_plain_law_swings_where_this_one_does_not():
    plain, _ = drive(make(mrac, p=0.02), 40.0, square)
    robust, _ = drive(make(p=0.02, leak_1ps=0.05, reach=0.5), 40.0, square)
    swing = [max(angles[-60:]) - min(angles[-60:]) for angles in (plain, robust)]
    assert swing[0] > 10.0 * swing[1]


def test_it_learns_an_actuator_gain():
    def error(p):
        angles, _ = drive(make(p=p, t_ref_s=0.07), 60.0, square, gain=0.8)
        return abs(angles[-1] + 20.0)  # the last half wave is the negative one

    assert error(0.01) < 0.3 * error(1e-4)


def test_with_the_identified_actuator_there_is_nothing_to_learn():
    _, state = drive(make(p=0.05, t_ref_s=0.07), 60.0, square)
    assert state.angle_gain == pytest.approx(0.0, abs=0.1)
    assert state.command_gain == pytest.approx(1.0, abs=0.1)


def test_gains_leak_back_and_stay_within_reach():
    _, learned = drive(make(p=0.1, t_ref_s=0.07, reach=0.1), 30.0, square, gain=0.5)
    assert learned.command_gain == pytest.approx(1.1)
    block = make(p=0.1, t_ref_s=0.07, leak_1ps=0.2)
    state = block.init(block.params, DT_S)._replace(begun=1.0, command_gain=1.5)
    for _ in range(3000):
        state, _ = block.step(block.params, state, (0.0, 0.0, 5.0), DT_S)
    assert state.command_gain == pytest.approx(1.0, abs=0.01)


def test_a_time_constant_of_zero_is_refused():
    with pytest.raises(InputError, match=r"mrac\.t_ref_s"):
        make(t_ref_s=0.0)
