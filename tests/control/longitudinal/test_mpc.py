"""Longitudinal MPC: it closes errors behind a delay, keeps to acceleration and jerk, and finds what is unknown."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.base.course import Tracking
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import Ins, Measurement, Report
from tunefree_hil.control.build import PartNames, own_values
from tunefree_hil.control.calibration_map import from_triples
from tunefree_hil.control.contract import LoopDelays, Settings, Setup, VehicleConstants
from tunefree_hil.control.longitudinal import mpc
from tunefree_hil.control.longitudinal.pid import STANDSTILL_MPS2
from tunefree_hil.control.parameters import BASELINES

DT_S = 0.01
MAP = from_triples([0.0, 0.0, 0.0, 0.0], [-5.0, -0.01, 0.01, 5.0], [-0.5, -0.15, 0.15, 0.8])
DELAYS = LoopDelays(drive_dead_time_s=0.1, drive_lag_s=0.1, bus_s=0.02)
DEFAULTS = {**BASELINES["as_shipped"], **own_values(PartNames(longitudinal="mpc"))}
DEAD_TICKS, LAG_S = 12, 0.13  # of the driveline: 0.25 s in all, the default of speed.preview_s


def make(**changes: float) -> Any:
    values = {**DEFAULTS, **{name.replace("__", "."): value for name, value in changes.items()}}
    return mpc.make(Setup(values, VehicleConstants(), MAP, Settings(), DT_S, delays=DELAYS))


def sight(station: float = 0.0, error: float = 0.0, v: float = 5.0, plan: float = 5.0, felt: float = 0.0) -> Any:
    tracking = Tracking(
        station_error_m=station,
        speed_error_mps=error,
        preview_accel_mps2=0.0,
        preview_speed_mps=plan,
        path_remaining_m=100.0,
    )
    return tracking, Measurement(Report(speed_mps=v), Ins(0.0, 0.0, 0.0, v, felt, 0.0))


class Course(list):
    """Rows (station error, speed error, acceleration command) of a drive, and the last state."""

    state: Any = None


def drive(block: Any, seconds: float, station: float = 0.0, error: float = 0.0, unknown: float = 0.0) -> Course:
    """At 5 m/s on a plan of constant speed, behind dead time and lag; unknown: an acceleration that acts too."""
    state, rows = block.init(block.params, DT_S), Course()
    line, accel = [0.0] * DEAD_TICKS, 0.0
    for _ in range(round(seconds / DT_S)):
        state, pedals = block.step(block.params, state, sight(station, error, 5.0 - error, felt=accel + unknown), DT_S)
        line.append(pedals.accel_mps2)
        accel += DT_S / LAG_S * (line.pop(0) - accel)
        station += DT_S * error
        error -= DT_S * (accel + unknown)
        rows.append((station, error, pedals.accel_mps2))
    rows.state = state
    return rows


@settings(max_examples=12)
@given(
    st.floats(-1.5, 1.5), st.floats(-1.0, 1.0), st.sampled_from([0.02, 0.16, 10.0]), st.sampled_from([0.3, 3.2, 16.0])
)
def test_errors_are_closed_behind_the_delay(station: float, error: float, q_station: float, q_speed: float) -> None:
    """Over the whole box: the prediction knows the delay."""
    rows = drive(make(mpc__q_station=q_station, mpc__q_speed=q_speed), 40.0, station, error)
    assert max(abs(row[1]) for row in rows[-100:]) < 0.05
    assert abs(rows[-1][0]) < 0.2
    assert rows.state.plan.counts.failed == 0


def test_what_acts_beside_the_command_is_found_and_taken_out() -> None:
    with_observer = drive(make(), 30.0, unknown=-0.5)
    without = drive(make(speed__observer_radps=0.0), 30.0, unknown=-0.5)
    assert abs(with_observer[-1][0]) < 0.05 < 0.5 < abs(without[-1][0])


def test_the_commands_keep_to_acceleration_and_jerk() -> None:
    block = make(mpc__q_speed=16.0, mpc__r_accel_rate=1e-4)
    rows = np.array(drive(block, 8.0, station=2.0, error=2.0))
    jerk = np.diff(rows[:, 2]) / DT_S
    assert rows[:, 2].max() == pytest.approx(2.0, abs=1e-3) and rows[:, 2].min() >= -6.0
    assert np.abs(jerk).max() <= mpc.JERK_MPS3 + 0.1
    assert np.abs(jerk).max() > 0.9 * mpc.JERK_MPS3, "else the bound was not asked"


def test_at_a_stop_it_brakes() -> None:
    block = make()
    state, pedals = block.step(block.params, block.init(block.params, DT_S), sight(v=0.1, plan=0.0), DT_S)
    assert pedals.accel_mps2 <= STANDSTILL_MPS2 and pedals.brake_frac > 0.15 and pedals.throttle_frac == 0.15
    rolling = sight(0.0, -0.8, 0.8, plan=0.0)
    for _ in range(100):
        state, pedals = block.step(block.params, state, rolling, DT_S)
    assert pedals.accel_mps2 < 2.0 * STANDSTILL_MPS2, "a vehicle that rolls on is braked harder"


@pytest.mark.parametrize(("name", "value"), [("mpc.r_accel", 0.0), ("mpc.q_station", -0.1), ("mpc.r_accel_rate", -1.0)])
def test_a_weight_that_is_none_is_named(name: str, value: float) -> None:
    with pytest.raises(InputError) as caught:
        make(**{name.replace(".", "__"): value})
    assert (caught.value.code, caught.value.key) == ("bad_parameter", name)
