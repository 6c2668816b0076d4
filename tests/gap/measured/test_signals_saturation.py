"""Sensors at their stop are told from sensors that are only noisy, coarse or at rest."""

from __future__ import annotations

import numpy as np

from tests.gap.made_answer import late_drive
from tunefree_hil.gap.measured.signals import drop_signals, find_sensor_limits
from tunefree_hil.learn.drives.drive import Drive

YAW = "report.yaw_rate_radps"


def with_yaw(values: np.ndarray) -> Drive:
    drive = late_drive()
    return drive._replace(fields={**drive.fields, YAW: values})


def test_a_made_drive_has_no_stop() -> None:
    assert find_sensor_limits(late_drive()) == []


def test_a_clipped_yaw_rate_is_found_and_taken_out() -> None:
    drive = late_drive()
    limit = 0.5 * float(np.max(np.abs(drive.fields[YAW])))
    clipped = with_yaw(np.clip(drive.fields[YAW], -limit, limit))
    stops = find_sensor_limits(clipped)
    assert {stop.value for stop in stops} == {-limit, limit} and all(stop.field == YAW for stop in stops)
    assert "is at the end of its range" in stops[0].text and 0.0 < stops[0].share < 0.5
    left = drop_signals(clipped, stops)
    assert YAW not in left.fields and YAW not in left.fresh and left.fields.keys() < clipped.fields.keys()


def test_a_coarse_sensor_is_no_saturated_one() -> None:
    values = late_drive().fields[YAW]
    assert find_sensor_limits(with_yaw(np.round(values / 0.02) * 0.02)) == []
