"""What is the same for all drives of a target: pooled over them, with what the model's own calibration missed."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.estimation.residuals import EXACT, FLOOR_SHARE, LEAST_OF_LEVEL, kind_of, missed_of, size_of
from tunefree_hil.gap.measured.targets import Target
from tunefree_hil.gap.model.card import HeldOut

ROWS = 4000
VALID = np.ones(ROWS, dtype=bool)


def target(noise: float, name: str = "rate_of_speed", size: float = 1.0, dt_s: float = 0.05, seed: int = 1) -> Target:
    measured = noise * np.random.default_rng(seed).standard_normal(ROWS)
    return Target(name, Link.REPORT_TO_MOTION, "m/s2", np.arange(ROWS), VALID, measured, dt_s, 0.0, size)


@pytest.mark.parametrize("first", [0, 1])
def test_no_drive_says_for_all_of_them_how_noisy_they_are(first: int) -> None:
    calm, loud = target(0.01, dt_s=0.05), target(0.7, dt_s=0.06, seed=2)
    kind = kind_of([calm, loud] if first == 0 else [loud, calm], 0.02)
    assert kind.floor == pytest.approx(FLOOR_SHARE * (0.5 * (0.01**2 + 0.7**2)) ** 0.5, rel=0.05)
    assert kind.dt_s == pytest.approx(0.055) and kind.missed == 0.02
    assert kind_of([target(0.0)], 0.0).floor == EXACT


def test_a_sensor_is_as_loud_as_it_is_in_the_target_and_the_floor_asks_for_its_roughness() -> None:
    rough = target(0.1)
    kind = kind_of([rough._replace(noise=0.7)], 0.0)
    assert kind.noise == 0.7 and kind.floor == kind_of([rough], 0.0).floor
    assert kind_of([rough._replace(noise=0.01)], 0.0).noise == pytest.approx(0.1, rel=0.05)


def test_wheels_are_off_by_a_share_of_the_speed_however_even_the_drive_is() -> None:
    even, lively = np.full(ROWS, 20.0), np.full(ROWS, 10.0)
    wheels = [target(0.01, "wheel_vs_ins", size=0.1)]
    assert size_of(wheels, [even]) == pytest.approx(LEAST_OF_LEVEL * 20.0)
    assert size_of([wheels[0]._replace(size=4.0)], [lively]) == 4.0
    assert size_of([target(0.01, size=0.1)], [even]) == pytest.approx(0.1), "a rate has no level"


def test_what_a_calibration_missed_of_other_drives_counts_less_the_noise_that_is_in_it() -> None:
    said = HeldOut({"yaw_rate_radps": 0.01, "speed_mps": 0.05}, {"brake": (0.005, 0.003)})
    assert missed_of("brake", said, 0.0) == pytest.approx(0.004)
    assert missed_of("yaw_rate", said, 0.008) == pytest.approx(0.006) and missed_of("yaw_rate", said, 0.02) == 0.0
    assert missed_of("rate_of_speed", said, 0.0) == 0.0, "of a rate the card says nothing"
    assert (
        missed_of("steer", said, 0.0)
        == missed_of("lateral_accel", said, 0.0)
        == missed_of("brake", HeldOut({}, {}), 0.0)
        == 0.0
    )
