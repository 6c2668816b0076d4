"""What share of a drive lies outside a model's valid region."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.config.schema import ValidSpec
from tunefree_hil.episode.recording import Recording, make_recording
from tunefree_hil.episode.validity_region import Outside, outside, together

TICKS = 1000


def recording(**columns: object) -> Recording:
    full = {name: np.broadcast_to(np.asarray(value, dtype=float), TICKS) for name, value in columns.items()}
    return make_recording({name: value.copy() for name, value in full.items()}, 0.01)


def share(drive: Recording, valid: ValidSpec) -> float:
    found = outside(drive, valid)
    assert found is not None
    return found.share


def ramp(low: float, high: float) -> np.ndarray:
    return np.linspace(low, high, TICKS)


def test_what_stays_inside_is_inside() -> None:
    drive = recording(speed_mps=ramp(0.0, 10.0), accel_mps2=0.5, out_steer_rad=0.1)
    valid = ValidSpec(speed_mps=[0.0, 10.0], accel_mps2=[-2.0, 2.0], steer_rad=[-1.0, 1.0])
    assert outside(drive, valid) == Outside(0.0, {}, TICKS)


def test_the_share_is_of_ticks_at_which_anything_is_outside() -> None:
    drive = recording(speed_mps=ramp(0.0, 10.0), lateral_accel_mps2=np.where(np.arange(TICKS) < 200, 5.0, 0.0))
    found = outside(drive, ValidSpec(speed_mps=[0.0, 5.0], lateral_accel_mps2=[-3.0, 3.0]))
    assert found is not None
    assert found.by["speed_mps"] == pytest.approx(0.49, abs=0.01)  # 2 % of the width are granted
    assert found.by["lateral_accel_mps2"] == pytest.approx(0.2, abs=0.01)
    assert found.share == pytest.approx(sum(found.by.values())), "they are not outside together"
    assert share(drive, ValidSpec(speed_mps=[0.0, 5.0])) == found.by["speed_mps"]


def test_noise_is_no_drive() -> None:
    noise = 0.3 * np.random.default_rng(1).standard_normal(TICKS)
    drive = recording(accel_mps2=1.7 + noise)
    assert share(drive, ValidSpec(accel_mps2=[-2.0, 2.0])) == 0.0
    assert share(recording(accel_mps2=2.3 + noise), ValidSpec(accel_mps2=[-2.0, 2.0])) > 0.9


def test_pedals_are_one_quantity_with_two_ends() -> None:
    valid = ValidSpec(pedals=[-0.25, 0.45])
    assert share(recording(out_throttle_frac=0.44, out_brake_frac=0.15), valid) == 0.0
    assert share(recording(out_throttle_frac=0.50, out_brake_frac=0.15), valid) == 1.0
    assert share(recording(out_throttle_frac=0.15, out_brake_frac=0.24), valid) == 0.0
    assert share(recording(out_throttle_frac=0.15, out_brake_frac=0.30), valid) == 1.0
    never_braked = ValidSpec(pedals=[0.15, 0.45])
    assert share(recording(out_throttle_frac=0.3, out_brake_frac=0.15), never_braked) == 0.0
    assert share(recording(out_throttle_frac=0.3, out_brake_frac=0.22), never_braked) == 1.0


def test_what_is_not_known_is_not_outside() -> None:
    speed = np.where(np.arange(TICKS) < 500, np.nan, 4.0)
    assert share(recording(speed_mps=speed), ValidSpec(speed_mps=[0.0, 5.0])) == 0.0
    drive = recording(speed_mps=4.0)
    assert outside(drive, ValidSpec()) is None and outside(drive, ValidSpec(pedals=[-0.3, 0.5])) is None


def test_several_drives_count_by_their_ticks() -> None:
    whole = together([Outside(0.5, {"speed_mps": 0.5}, 100), None, Outside(0.0, {}, 300)])
    assert whole == Outside(0.125, {"speed_mps": 0.125}, 400)
    assert together([None]) is None and together([]) is None
