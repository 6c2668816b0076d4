"""Noise, quantisation, rates, and the driven range."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import NOISE, QUANTUM, made_drive, whole
from tunefree_hil.learn.drives.smoothing import (
    estimate_mean_noise,
    estimate_noise,
    estimate_noise_table,
    estimate_quantum,
    estimate_rate,
    estimate_valid_region,
    interpolate_fresh,
)


@pytest.mark.parametrize(("sigma", "quantum"), [(0.01, 0.0), (0.01, 0.01), (0.003, 0.001)])
def test_noise_is_told_from_signal_and_rounding(sigma: float, quantum: float) -> None:
    chance = np.random.default_rng(2)
    truth = 3.0 * np.sin(np.arange(20000) * 0.01 * 2.0 * np.pi * 0.5)
    seen = truth + sigma * chance.standard_normal(len(truth))
    seen = np.round(seen / quantum) * quantum if quantum else seen
    assert estimate_noise(seen, quantum) == pytest.approx(sigma, rel=0.06)


def test_the_step_of_the_wire() -> None:
    chance = np.random.default_rng(2)
    assert estimate_quantum(np.round(chance.uniform(0, 1, 5000) / 0.002) * 0.002) == pytest.approx(0.002)
    assert estimate_quantum(np.full(5, 3.0)) == 0.0


def test_a_made_drive_has_the_noise_it_was_made_with() -> None:
    noise_by_field = estimate_noise_table([whole(made_drive(60.0))])
    for name in ("report.speed_mps", "report.steer_rad", "report.yaw_rate_radps", "ins.heading_rad", "ins.x_m"):
        assert noise_by_field[name] == pytest.approx(NOISE[name.partition(".")[2]], rel=0.15), name
    assert "report.wheel_fl_radps" not in noise_by_field, "it was not reported"
    assert QUANTUM["steer_rad"] > NOISE["steer_rad"], "rounding coarser than the noise was taken off"


def test_rates_come_from_fresh_values_only() -> None:
    fresh = np.zeros(400, dtype=bool)
    fresh[::4] = True
    truth = 0.3 * np.arange(400) * 0.01
    held_values = np.repeat(truth[::4], 4)
    assert interpolate_fresh(held_values, fresh)[:396] == pytest.approx(truth[:396])
    assert estimate_rate(held_values, fresh, 21, 0.01)[50:350] == pytest.approx(0.3)


def test_the_valid_region_is_what_was_driven() -> None:
    drive = made_drive(40.0)
    region = estimate_valid_region([whole(drive)], 0.15)
    speed = drive.fields["report.speed_mps"]
    assert region["speed_mps"] == pytest.approx((speed.min(), speed.max()), abs=0.3)
    assert region["pedals"][0] < -0.2 and region["pedals"][1] > 0.3
    assert region["lateral_accel_mps2"][0] < 0.0 < region["lateral_accel_mps2"][1]


def test_an_accelerometer_that_shakes_tells_no_slope() -> None:
    chance = np.random.default_rng(4)
    fresh = np.zeros(4000, dtype=bool)
    fresh[::10] = True
    quiet, shaking = (one * chance.standard_normal(4000) for one in (0.01, 0.1))
    assert estimate_mean_noise(quiet, fresh, 200) == pytest.approx(0.01 / 20.0**0.5, rel=0.1)
    assert estimate_mean_noise(shaking + 0.04, fresh, 200) > 0.0075 > estimate_mean_noise(quiet + 0.04, fresh, 200)
    assert estimate_mean_noise(quiet[:20], fresh[:20], 200) == float("inf")
