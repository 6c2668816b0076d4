"""MRAC of order 1 to 4: the two published orders to the bit, the model that includes the dead time above."""

from __future__ import annotations

import hashlib
import math
import struct
from typing import get_args, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control.inner.steering_loop import CALM, DT_S, drive, make_block
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ControllerSpec
from tunefree_hil.control.contract import LoopDelays, Settings, Setup, VehicleConstants
from tunefree_hil.control.inner import mrac, mrac_robust
from tunefree_hil.control.mrac_model import (
    LARGEST_ORDER,
    actuator_tau_s,
    last_column,
    lyapunov_pb,
    model_coefficients,
    reference_model,
    start_gains,
    time_unit_s,
)
from tunefree_hil.control.parameters import BASELINES

MKZ = VehicleConstants()
# Written by the code that had orders 1 and 2 only (093aaa0).
GOLDEN = {
    "order 1": (Settings(), 1e-2, "8c83b8461daa4fbb016b4636a0b7cdb7eccf6385752c545d1762ff70a6b89211"),
    "order 1, dead zone": (
        Settings(mrac_dead_zone=0.5),
        1e-2,
        "daf37ed91363c489eb7e1fb7b8dc0d8248a3d8bf77bd8109a1c45e66836f5f13",
    ),
    "order 2": (Settings(mrac_order=2), 1e-6, "25f6aba965100562fabfc51225fd56c8fb0c4283825efabe33524216c563f6a4"),
    "order 2, shape": (
        Settings(mrac_order=2, mrac_shape=(10.0, 0.01, 0.1)),
        1e-6,
        "38fc674d8e8968d6327219bde8d4b801c0c97f6d36c79e0b485bae9f8d19f3ac",
    ),
    "paper, order 1": (
        Settings(mrac_form="paper"),
        1e-4,
        "f08a2a3f27083f9e37994d9bd62ae290338299ceb503bcd81f01f6790703d7a4",
    ),
    "paper, order 2": (
        Settings(mrac_form="paper", mrac_order=2),
        1e-7,
        "70c96173635dc4601a585e04609d49345ab76facd65fd942b345edea772befd1",
    ),
}


@pytest.mark.parametrize("name", GOLDEN)
def test_the_published_orders_answer_to_the_bit_as_before(name: str) -> None:
    settings, p, golden = GOLDEN[name]
    block = make_block(settings, MKZ, p=p)
    state, digest, seed, angle_rad = block.init(block.params, DT_S), hashlib.sha256(), 12345, 0.0
    for k in range(1500):
        seed = (1103515245 * seed + 12345) % 2147483648
        wish_rad = (3.0 if (k // 150) % 2 == 0 else -3.0) + 0.2 * (seed / 2147483648 - 0.5)
        measured_rad = round(angle_rad / 0.001745) * 0.001745
        state, answer = block.step(block.params, state, (wish_rad, measured_rad, 0.01 * k), DT_S)
        angle_rad += 0.08 * (answer.steer_rad - angle_rad)
        digest.update(struct.pack("<2d", answer.steer_rad, answer.status))
    assert digest.hexdigest() == golden


@given(t_ref_s=st.floats(0.01, 0.5), dead_s=st.floats(0.06, 0.4), order=st.integers(3, LARGEST_ORDER))
def test_p_solves_the_lyapunov_equation(t_ref_s: float, dead_s: float, order: int) -> None:
    vehicle, settings = MKZ._replace(steer_dead_time_s=dead_s), Settings(mrac_order=order)
    coefficients = model_coefficients(t_ref_s, settings, vehicle)
    # the polynomial is that of the lags, in its unit of time
    unit_s, lag_s = time_unit_s(t_ref_s, settings, vehicle), dead_s / (order - 1)
    poles = np.array([1.0 / t_ref_s] + [1.0 / lag_s] * (order - 1)) * unit_s
    assert np.poly(-poles)[:0:-1] == pytest.approx(coefficients)
    a = np.diag(np.ones(order - 1), 1)
    a[-1] = [-value for value in coefficients]
    identity = np.eye(order)
    p = np.linalg.solve(np.kron(identity, a.T) + np.kron(a.T, identity), -2.0 * identity.ravel()).reshape(order, order)
    assert np.all(np.linalg.eigvalsh(p) > 0.0)
    column = last_column(coefficients)
    assert column == pytest.approx(list(p[:, -1]), rel=1e-6)
    assert column[0] == pytest.approx(1.0)
    assert lyapunov_pb(t_ref_s, 0.01, settings, vehicle) == pytest.approx([0.01 * value for value in column])


@pytest.mark.parametrize("order", [3, 4])
def test_the_model_is_a_lag_and_the_dead_time(order: int) -> None:
    """It is as late as T and the dead time together, does not overshoot, and ends at the command."""
    settings, t_ref_s = Settings(mrac_order=order), 0.09
    model = reference_model(t_ref_s, settings, MKZ, DT_S)
    m, n = np.reshape(model.m, (order, order)), np.array(model.n)
    states, angles = np.zeros(order), []
    for k in range(300):
        states = m @ states + n * (1.0 if k == 0 else 2.0)  # the step begins half a tick before this sample
        angles.append(states[0])
    lateness_s = DT_S * sum(1.0 - angle for angle in angles)
    assert lateness_s == pytest.approx(t_ref_s + MKZ.steer_dead_time_s, abs=1e-6)
    assert max(angles) == pytest.approx(1.0, abs=1e-9) and angles[-1] == pytest.approx(1.0, abs=1e-9)
    early = {n_lags: reference_rise(n_lags, 0.05) for n_lags in (1, order)}
    assert early[order] < 0.5 * early[1], "during the dead time it waits"


def reference_rise(order: int, after_s: float) -> float:
    """The step response of the model of an order after a time."""
    model = reference_model(0.09, Settings(mrac_order=order), MKZ, DT_S)
    m, n, states = np.reshape(model.m, (order, order)), np.array(model.n), np.zeros(order)
    for k in range(round(after_s / DT_S)):
        states = m @ states + n * (1.0 if k == 0 else 2.0)
    return float(states[0])


@pytest.mark.parametrize("order", [1, 3, 4])
@pytest.mark.parametrize("t_ref_s", [0.06, 0.09, 0.2])
def test_start_gains_make_the_assumed_actuator_the_model(order: int, t_ref_s: float) -> None:
    """In the frequency domain: command gain x G / (1 - angle gains x G) is the model."""
    settings = Settings(mrac_order=order)
    start, unit_s = start_gains(t_ref_s, MKZ, settings), time_unit_s(t_ref_s, settings, MKZ)
    lag_s = MKZ.steer_dead_time_s / (order - 1) if order > 1 else 0.0
    for omega_radps in (0.0, 3.0, 30.0):
        s = 1j * omega_radps
        actuator = 1.0 / ((actuator_tau_s(MKZ) * s + 1.0) * (lag_s * s + 1.0) ** (order - 1))
        back = sum(gain * (unit_s * s) ** i for i, gain in enumerate(start.angle))
        wanted = 1.0 / ((t_ref_s * s + 1.0) * (lag_s * s + 1.0) ** (order - 1))
        assert start.command * actuator / (1.0 - back * actuator) == pytest.approx(wanted)


def test_derivatives_of_a_slow_swing_are_those_of_the_swing() -> None:
    differentiator = mrac.make_differentiator(4, 0.05, DT_S)
    row, lows, omega_radps = [0.0] * 4, [0.0] * 4, 2.0
    for k in range(1000):
        mrac.fill_derivatives(row, lows, differentiator, math.sin(omega_radps * k * DT_S))
    lag_s = mrac.FILTER_S + 0.5 * DT_S  # of each derivative: the filter and half a tick
    for i in range(4):
        phase = omega_radps * (999 * DT_S - i * lag_s) + 0.5 * math.pi * i
        assert row[i] == pytest.approx((0.05 * omega_radps) ** i * math.sin(phase), abs=5e-3 * 0.1**i)


@pytest.mark.parametrize("order", [3, 4])
@pytest.mark.parametrize(("form", "p"), [("apollo", 1e-4), ("apollo", 1e-3), ("paper", 1e-4), ("paper", 1e-3)])
def test_with_the_data_sheet_actuator_it_is_calm_and_nearer_to_its_reference(order: int, form: str, p: float) -> None:
    first, higher = (drive(make_block(Settings(mrac_order=n, mrac_form=form), p=p)) for n in (1, order))
    assert higher.reference_error_rad() < 0.5 * first.reference_error_rad()
    assert higher.command_rate_radps() < 1.1 * first.command_rate_radps()
    assert np.max(np.abs(higher.command_rad)) < 1.35 * 2.0, "no more than the lead of the start gains"


def test_a_larger_p_is_calm_with_a_higher_order() -> None:
    """1e-2 with the study's clamp: order 1 blames the dead time on the gains and swings, order 4 does not."""
    first, higher = (drive(make_block(Settings(mrac_order=n, mrac_dead_zone=0.5), p=1e-2)) for n in (1, 4))
    assert higher.command_rate_radps() < 5.0 < 50.0 < first.command_rate_radps()


@pytest.mark.parametrize("order", [3, 4])
def test_it_learns_a_slower_actuator(order: int) -> None:
    """p = 1e-5 learns nothing in this time."""
    idle, learning = (drive(make_block(Settings(mrac_order=order), p=p), 80.0, lag_s=0.2) for p in (1e-5, 1e-3))
    assert learning.reference_error_rad() < 0.75 * idle.reference_error_rad()
    assert np.max(np.abs(learning.gains[-1] - learning.gains[0])) > 0.1


def test_every_gain_stays_within_the_clamp_and_one_outside_stops_all() -> None:
    block = make_block(Settings(mrac_order=3), p=0.05, clamp_s=0.08)
    params, loop = block.params, drive(block, 20.0)
    assert np.all(loop.gains[:, :3] <= 0.0) and np.all(loop.gains[:, :3] >= np.array(params.x_low))
    assert np.all(loop.gains[:, 3] >= 1.0) and np.all(loop.gains[:, 3] <= params.r_high)
    state = block.init(params, DT_S)
    state.angle[:], state.last_angle[:] = [10.0, 10.0, 10.0], [10.0, 10.0, 10.0]
    inside = mrac.adapt(params, state, -10.0, -10.0, 0.01, DT_S)
    assert inside > params.start_command and all(a < b for a, b in zip(state.gains, params.start, strict=True))
    state.gains[1] = params.x_low[1]
    before = [*state.gains]
    assert mrac.adapt(params, state, -10.0, -10.0, 0.01, DT_S) == params.start_command and state.gains == before


def test_anti_windup_of_the_rate_counts_in_the_unit_of_the_model() -> None:
    block = make_block(Settings(mrac_order=3), CALM, p=1e-3)
    params, free = block.params, 130.0
    out = mrac.limit_output(params, free, 0.0, 100.0, DT_S)
    assert (out.value, out.status) == (100.0, 1.0)
    assert out.windup == pytest.approx(params.anti_windup * (100.0 - free))
    assert out.rate_windup == pytest.approx(params.anti_windup * params.unit_s * (10000.0 - free / DT_S))


def test_the_outer_loops_are_told_the_lag_that_is_there() -> None:
    """The mean lateness of the wheel with start gains, from the loop itself, which starts at rest."""
    for order in (1, 3, 4):
        settings = Settings(mrac_order=order)
        delays = LoopDelays(steer_dead_time_s=0.1, steer_lag_s=0.085, bus_s=0.02)
        values = {**BASELINES["mrac_on"], "mrac.p": 1e-9}
        lag_s = mrac.loop_lag_s(Setup(values, CALM, None, settings, DT_S, delays=delays))
        loop = drive(make_block(settings, p=1e-9), 2.4)
        lateness_s = float(np.sum(loop.demand_rad - loop.wheel_rad)) * DT_S / 2.0
        assert lag_s + 0.12 == pytest.approx(lateness_s - 0.0225 / 1.364, abs=0.01)  # the low-pass filter's own


@pytest.mark.parametrize(
    ("settings", "vehicle", "key"),
    [
        (Settings(mrac_order=0), MKZ, "controller.mrac_order"),
        (Settings(mrac_order=LARGEST_ORDER + 1), MKZ, "controller.mrac_order"),
        (Settings(mrac_order=3), MKZ._replace(steer_dead_time_s=0.03), "controller.mrac_order"),
        (Settings(mrac_order=3, mrac_shape=(1.0, 0.0, 1.0)), MKZ, "mrac_shape"),
        (Settings(mrac_form="other"), MKZ, "controller.mrac_order"),
    ],
)
def test_mistakes_are_refused(settings: Settings, vehicle: VehicleConstants, key: str) -> None:
    with pytest.raises(InputError) as refused:
        make_block(settings, vehicle)
    assert (refused.value.code, refused.value.key) == ("bad_mrac", key)


def test_switched_off_no_order_is_refused() -> None:
    block = make_block(Settings(mrac_order=4), MKZ._replace(steer_dead_time_s=0.0), enable=0.0)
    state = block.init(block.params, DT_S)
    assert block.step(block.params, state, (0.3, math.nan, 5.0), DT_S)[1] == (0.3, 0.0)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_a_tick_that_the_cascade_takes_back_leaves_no_trace(order: int) -> None:
    """Buffers are reused, so a first tick is begun anew, and one without a number changes nothing."""
    block = make_block(Settings(mrac_order=order), p=1e-3)
    fresh, begun = block.init(block.params, DT_S), block.init(block.params, DT_S)
    block.step(block.params, begun, (0.5, 1.5, 5.0), DT_S)  # its state is not used
    _, lost = block.step(block.params, begun, (0.5, math.nan, 5.0), DT_S)
    assert math.isnan(lost.steer_rad)
    for k in range(50):
        x = (0.3 + 0.01 * k, 0.2 + 0.008 * k, 5.0)
        fresh, wanted = block.step(block.params, fresh, x, DT_S)
        begun, answer = block.step(block.params, begun, x, DT_S)
        assert answer == wanted
        assert block.step(block.params, begun, (math.inf, 0.1, 5.0), DT_S)[0] is begun
    assert [*begun.gains, begun.command_gain] == [*fresh.gains, fresh.command_gain]


@pytest.mark.parametrize("settings", [Settings(mrac_order=3), Settings(mrac_form="paper")])
def test_the_robust_law_has_order_1_only(settings: Settings) -> None:
    delays = LoopDelays(steer_dead_time_s=0.1, steer_lag_s=0.08)
    values = {**BASELINES["mrac_on"], "mrac.leak_1ps": 0.1, "mrac.reach": 0.5}
    with pytest.raises(InputError, match="mrac_robust has neither"):
        mrac_robust.make(Setup(values, MKZ, None, settings, DT_S, delays=delays))


def test_the_bench_file_has_the_orders_that_there_are() -> None:
    assert get_args(get_type_hints(ControllerSpec)["mrac_order"]) == tuple(range(1, LARGEST_ORDER + 1))


def test_order_2_has_no_reference_time_constant() -> None:
    """Its reference model is given by natural frequency and damping."""
    settings = Settings(mrac_order=2)
    assert start_gains(0.0, MKZ, settings) == start_gains(0.09, MKZ, settings)
