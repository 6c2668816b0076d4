"""What the figures of a calibration are drawn from: the stretches in which something goes on, errors that grow."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import DT_S, made_drive, made_pairs, whole
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.learn.actuators.samples import ActuatorSamples, ChannelSamples
from tunefree_hil.learn.evaluation.plot_data import LONG_TRACE_S, SHORT_TRACE_S, compare_constants, make_traces
from tunefree_hil.learn.physics.windows import OutputCorrection, extract_windows
from tunefree_hil.plant.actuation.actuators import ActuatorParams
from tunefree_hil.plant.data_sheet import DEFAULTS

WAY = ActuatorParams(dead_time_s=0.05, lag_s=0.06)


def test_a_long_and_a_short_stretch_are_shown_beside_what_the_fit_puts_out() -> None:
    pairs = made_pairs(WAY, 20.0, 5)
    found = make_traces(pairs, WAY)
    assert [len(one.command) for one in found] == [round(LONG_TRACE_S / DT_S), round(SHORT_TRACE_S / DT_S)]
    for one in found:
        came = np.isfinite(one.output)
        assert came.any() and one.fit[came] == pytest.approx(one.output[came], abs=1e-9), "the truth misses nothing"
    assert make_traces(ChannelSamples("steer", (), ""), WAY) == []


def test_the_stretch_is_where_most_goes_on() -> None:
    """A minute of nothing, then a wheel that is turned, then a larger move that no report speaks of."""
    command = np.zeros(8000)
    command[6000:6800] = np.sin(np.arange(800) * DT_S * 8.0)
    command[7000:7400] = 3.0 * np.sin(np.arange(400) * DT_S * 8.0)
    counts = np.arange(8000) < 6900
    short = make_traces(ChannelSamples("steer", (ActuatorSamples(command, command, counts, DT_S),), ""), WAY)[1]
    assert short.time_s[0] >= 60.0 and short.time_s[-1] < 69.0
    assert np.isfinite(short.output).all() and np.abs(short.command).max() == pytest.approx(1.0, abs=0.01)


def test_free_runs_of_a_wrong_car_are_off_by_more_the_longer_they_last() -> None:
    drive = made_drive(18.0, seed=3)
    some = extract_windows([whole(drive)], load_vehicle("mkz_bywire")).windows
    heavy = {**DEFAULTS, "drive_force_n": 0.5 * DEFAULTS["drive_force_n"]}
    found = compare_constants(some, (heavy, OutputCorrection()), (DEFAULTS, OutputCorrection()))
    assert found is not None and found.n_windows == len(some) > 0
    assert found.before["x_m"] > 5.0 * found.after["x_m"] and found.before["speed_mps"] > 5.0 * found.after["speed_mps"]
    assert found.time_s[-1] == pytest.approx(8.0) and found.before_by_time[-1, 4] > 2.0 * found.before_by_time[20, 4]
    assert compare_constants([], (heavy, OutputCorrection()), (DEFAULTS, OutputCorrection())) is None
