"""Samples: what is nearly steady, what a window's course is, and logs that lack a signal."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.steering_map.made_turns import DT_S, TRUTH, VEHICLE, turning_drive, without
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_REVERSE
from tunefree_hil.learn.steering_map.samples import CRITERIA, collect_steady_samples, sample_drive

DRIVE = turning_drive(seconds=60.0, noise=0.0)


def test_samples_are_means_of_the_drive() -> None:
    samples = sample_drive(DRIVE, VEHICLE)
    assert 300 < len(samples.block) <= 600
    assert np.all(samples.speed_mps > CRITERIA.min_speed_mps)
    assert np.all(np.abs(samples.yaw_accel_radps2) <= CRITERIA.max_yaw_accel_radps2)
    assert np.unique(samples.block).tolist() == list(range(12))
    lateral = samples.speed_mps * samples.yaw_rate_radps
    assert np.abs(samples.rear_slip_rad + TRUTH.rear_slip_s2pm * lateral).max() < 0.002


def test_a_turn_without_slip_has_none_whatever_its_heading() -> None:
    truth = TRUTH._replace(rear_slip_s2pm=0.0)
    drive = turning_drive(truth, seconds=120.0, noise=0.0)
    x, y, heading = (drive.fields[name] for name in ("ins.x_m", "ins.y_m", "ins.heading_rad"))
    heading = np.arctan2(np.sin(heading + np.pi), np.cos(heading + np.pi))  # towards minus x, where angles jump
    samples = sample_drive(
        drive._replace(fields={**drive.fields, "ins.x_m": -x, "ins.y_m": -y, "ins.heading_rad": heading}), VEHICLE
    )
    assert np.nanmax(np.abs(samples.rear_slip_rad)) < 5e-4


def test_a_quick_wheel_is_not_steady() -> None:
    wheel = DRIVE.fields["report.steer_rad"].copy()
    time_s = np.arange(len(wheel)) * DT_S
    wheel[2000:4000] += 0.3 * np.sin(2.0 * np.pi * 0.8 * time_s[2000:4000])
    shaken = DRIVE._replace(fields={**DRIVE.fields, "report.steer_rad": wheel})
    calm, rough = (sample_drive(drive, VEHICLE) for drive in (DRIVE, shaken))
    inside = [np.sum((samples.block >= 4) & (samples.block < 8)) for samples in (calm, rough)]
    assert inside[1] < 0.5 * inside[0] and np.sum(calm.block < 3) == np.sum(rough.block < 3)


def test_reverse_gear_and_gaps_do_not_count() -> None:
    gear = np.full(DRIVE.n_rows, 4.0)
    gear[:3000] = GEAR_REVERSE
    fields = {**DRIVE.fields, "report.gear": gear}
    fresh = {**DRIVE.fresh, "report.gear": np.ones(DRIVE.n_rows, dtype=bool)}
    samples = sample_drive(DRIVE._replace(fields=fields, fresh=fresh), VEHICLE)
    assert samples.block.min() == 6
    lost = DRIVE.fresh["report.steer_rad"].copy()
    lost[3000:] = False
    assert sample_drive(DRIVE._replace(fresh={**DRIVE.fresh, "report.steer_rad": lost}), VEHICLE).block.max() == 5


def test_blocks_of_two_drives_are_apart() -> None:
    samples = collect_steady_samples([DRIVE, DRIVE], VEHICLE)
    assert len(np.unique(samples.block)) == 24


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        (("report.steer_rad",), "no_steer"),
        (("ins.speed_mps",), "no_speed"),
        (("ins.yaw_rate_radps",), "no_yaw_rate"),
    ],
)
def test_a_log_without_a_signal_is_named(fields: tuple[str, ...], code: str) -> None:
    with pytest.raises(InputError) as caught:
        collect_steady_samples([without(DRIVE, *fields)], VEHICLE)
    assert caught.value.code == code and caught.value.file == "made" and caught.value.hint


def test_a_drive_shorter_than_a_window_has_no_samples() -> None:
    assert len(sample_drive(turning_drive(seconds=0.3), VEHICLE).block) == 0


def test_no_drive() -> None:
    with pytest.raises(InputError, match="no drive"):
        collect_steady_samples([], VEHICLE)
