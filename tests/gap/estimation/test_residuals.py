"""Properties of a target, pooled over its drives, and the misfit of the model's own calibration."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.estimation.residuals import (
    CRITERIA,
    misfit_beyond_noise,
    pool_signal_scale,
    pool_target_properties,
)
from tunefree_hil.gap.measured.targets import Target
from tunefree_hil.gap.model.card import HoldoutErrors

ROWS = 4000
VALID = np.ones(ROWS, dtype=bool)


def target(noise: float, name: str = "rate_of_speed", size: float = 1.0, dt_s: float = 0.05, seed: int = 1) -> Target:
    measured = noise * np.random.default_rng(seed).standard_normal(ROWS)
    return Target(name, Link.REPORT_TO_MOTION, "m/s2", np.arange(ROWS), VALID, measured, dt_s, 0.0, size)


@pytest.mark.parametrize("first", [0, 1])
def test_noise_is_pooled_over_the_drives(first: int) -> None:
    calm, loud = target(0.01, dt_s=0.05), target(0.7, dt_s=0.06, seed=2)
    kind = pool_target_properties([calm, loud] if first == 0 else [loud, calm], 0.02)
    assert kind.floor == pytest.approx(CRITERIA.min_sensor_share * (0.5 * (0.01**2 + 0.7**2)) ** 0.5, rel=0.05)
    assert kind.dt_s == pytest.approx(0.055) and kind.calibration_misfit == 0.02
    assert pool_target_properties([target(0.0)], 0.0).floor == CRITERIA.min_signal_share


def test_noise_is_that_in_the_target_and_the_floor_is_from_white_noise() -> None:
    rough = target(0.1)
    kind = pool_target_properties([rough._replace(noise=0.7)], 0.0)
    assert kind.noise == 0.7 and kind.floor == pool_target_properties([rough], 0.0).floor
    assert pool_target_properties([rough._replace(noise=0.01)], 0.0).noise == pytest.approx(0.1, rel=0.05)


def test_the_scale_of_wheel_speed_errors_is_at_least_a_share_of_the_speed() -> None:
    even, lively = np.full(ROWS, 20.0), np.full(ROWS, 10.0)
    wheels = [target(0.01, "wheel_vs_ins", size=0.1)]
    assert pool_signal_scale(wheels, [even]) == pytest.approx(CRITERIA.min_level_share * 20.0)
    assert pool_signal_scale([wheels[0]._replace(size=4.0)], [lively]) == 4.0
    assert pool_signal_scale([target(0.01, size=0.1)], [even]) == pytest.approx(0.1), "a rate has no level"


def test_the_misfit_of_a_calibration_counts_without_its_noise() -> None:
    said = HoldoutErrors({"yaw_rate_radps": 0.01, "speed_mps": 0.05}, {"brake": (0.005, 0.003)})
    assert misfit_beyond_noise("brake", said, 0.0) == pytest.approx(0.004)
    assert (
        misfit_beyond_noise("yaw_rate", said, 0.008) == pytest.approx(0.006)
        and misfit_beyond_noise("yaw_rate", said, 0.02) == 0.0
    )
    assert misfit_beyond_noise("rate_of_speed", said, 0.0) == 0.0, "the card has no rate"
    assert (
        misfit_beyond_noise("steer", said, 0.0)
        == misfit_beyond_noise("lateral_accel", said, 0.0)
        == misfit_beyond_noise("brake", HoldoutErrors({}, {}), 0.0)
        == 0.0
    )
