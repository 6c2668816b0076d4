"""The signals that are compared: simulated ones as a pose would show them, measured ones with their noise."""

from __future__ import annotations

import numpy as np
import pytest

from tests.gap.measured.test_targets import TICKS, T, opened, targets
from tests.learn.made_drives import DT_S
from tunefree_hil.gap.measured.signals import Signal
from tunefree_hil.gap.measured.targets import (
    COLUMN_INDEX,
    add_sensor_noise,
    build_measured_columns,
    build_simulated_columns,
)
from tunefree_hil.gap.model.kernels import N_SIMULATED, SIMULATED_FIELDS
from tunefree_hil.learn.drives.smoothing import estimate_rate


def test_what_was_made_of_a_pose_is_compared_with_the_same_slope_of_the_simulation() -> None:
    """A heading that the simulation drives, seen as a pose: its slope is what the simulated yaw rate comes to."""
    drive, window = opened()._replace(derived_ticks={"ins.yaw_rate_radps": 21}), 21
    yaw = np.sin(40.0 * T * T / T[-1])  # up to 13 Hz: much of it is smoothed away
    shown = np.zeros((TICKS, max(N_SIMULATED, len(SIMULATED_FIELDS))))
    shown[:, COLUMN_INDEX["ins_yaw_rate_radps"]] = shown[:, COLUMN_INDEX["yaw_rate_radps"]] = yaw
    heading = DT_S * np.concatenate([[0.0], np.cumsum(0.5 * (yaw[1:] + yaw[:-1]))])
    measured = estimate_rate(heading, np.ones(TICKS, dtype=bool), window, DT_S)
    columns, inside = build_simulated_columns(shown, drive), slice(50, -50)
    assert columns["ins_yaw_rate_radps"][inside] == pytest.approx(measured[inside], abs=1e-9)
    assert np.abs(measured - yaw)[inside].max() > 0.2 and np.array_equal(columns["yaw_rate_radps"], yaw)


@pytest.mark.parametrize("every", [1, 10])
def test_a_sensor_is_as_loud_in_a_target_as_smoothing_leaves_it_however_seldom_it_speaks(every: int) -> None:
    """A car that shakes, seen every tick or ten times a second: of the second hardly anything is smoothed away."""
    fresh = np.arange(TICKS) % every == 0
    truth = 0.1 * np.sin(0.4 * T)
    seen = (truth + 0.5 * np.random.default_rng(3).standard_normal(TICKS))[fresh]
    drive = opened()
    lines = np.interp(np.arange(TICKS), np.flatnonzero(fresh), seen)
    signal = Signal(lines, fresh, np.ones(TICKS, dtype=bool), lines)
    yaw = targets(drive._replace(signals={**drive.signals, "report.yaw_rate_radps": signal}))["yaw_rate"]
    loud = float(np.std((yaw.measured - truth[yaw.rows])[yaw.valid]))
    assert yaw.noise == pytest.approx(loud, rel=0.25)
    assert (loud > 0.3) == (every == 10)


def test_a_signal_that_is_all_gaps_gets_no_noise() -> None:
    drive = opened()
    gaps = {name: one._replace(is_valid=np.zeros(TICKS, dtype=bool)) for name, one in drive.signals.items()}
    columns = build_measured_columns(drive)
    same = add_sensor_noise(columns, drive._replace(signals=gaps))
    assert all(np.array_equal(same[name], columns[name]) for name in ("speed_mps", "yaw_rate_radps", "travel"))
    assert not np.array_equal(add_sensor_noise(columns, drive)["speed_mps"], columns["speed_mps"])


def test_a_wire_that_rounds_coarsely_is_noise_though_most_values_stand() -> None:
    drive = opened()
    slow = 10.0 + 0.03 * T
    steps = np.round(slow / 0.1) * 0.1
    coarse = Signal(steps, np.ones(TICKS, dtype=bool), np.ones(TICKS, dtype=bool), steps)
    rounded = drive._replace(signals={**drive.signals, "report.speed_mps": coarse})
    columns = build_measured_columns(rounded)
    loud = float(np.std(add_sensor_noise(columns, rounded)["speed_mps"] - columns["speed_mps"]))
    assert loud == pytest.approx(0.1 / np.sqrt(12.0), rel=0.1)
