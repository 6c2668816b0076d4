"""An accelerometer's offset is distinguished from the slope of the road where the drive allows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.learn.made_drives import DT_S, as_drive
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.drives.road_slope import describe_accel_offsets, estimate_accel_offset, find_constant_slope

ROUND = np.linspace(0.0, 6.0 * np.pi, 90)  # three times about the compass
HALF = np.linspace(0.0, np.pi, 90)


@pytest.fixture(scope="module")
def vehicle(repo: Path) -> VehicleSpec:
    return load_vehicle(repo / "dbc" / "mkz_bywire")


def shaking(n: int = 90, size: float = 0.001) -> np.ndarray:
    return np.random.default_rng(7).normal(0.0, size, n)


@pytest.mark.parametrize("headings", [ROUND, HALF], ids=["to all sides", "half way round"])
@pytest.mark.parametrize("offset", [0.02, -0.04, 0.06])
def test_what_stands_while_the_car_turns_is_the_sensors(headings: np.ndarray, offset: float) -> None:
    assert find_constant_slope(offset + shaking(), headings) == pytest.approx(offset, abs=0.001)


def test_a_place_that_slopes_evenly_has_no_part_in_it() -> None:
    assert find_constant_slope(0.02 + 0.03 * np.cos(ROUND) + shaking(), ROUND) == pytest.approx(0.02, abs=0.001)
    assert find_constant_slope(0.03 * np.sin(ROUND) + shaking(), ROUND) == 0.0


@pytest.mark.parametrize(
    ("slopes", "headings"),
    [
        (0.02 + shaking(), 0.1 * shaking()),  # straight on: it may climb all the way
        (0.02 + shaking(size=0.006), HALF),  # turns and climbs, not evenly: a road
        (0.02 + shaking(size=0.015), ROUND),  # hills
        (0.08 + shaking(size=0.006), ROUND),  # steep, and not as even as a slope that follows the car
        (0.3 + shaking(), ROUND),  # no road, and no mounting
        (0.02 + shaking(30), ROUND[:30]),  # a minute only
        (np.zeros(0), np.zeros(0)),
    ],
    ids=["straight", "uneven", "hills", "steep", "broken", "short", "nothing"],
)
def test_where_a_drive_does_not_tell_it_nothing_is_said(slopes: np.ndarray, headings: np.ndarray) -> None:
    assert find_constant_slope(slopes, headings) == 0.0


def drive_with(bias_mps2: float, seconds: float = 120.0) -> Drive:
    """The speed varies, the car drives in all directions, and its accelerometer has a bias."""
    time_s = np.arange(round(seconds / DT_S)) * DT_S
    speed, yaw = 6.0 + 2.0 * np.sin(0.5 * time_s), np.full(len(time_s), 0.2)
    felt = np.cos(0.5 * time_s) - 1.2 * yaw * yaw + bias_mps2
    fields = {"report.speed_mps": speed, "report.yaw_rate_radps": yaw, "report.accel_mps2": felt}
    return as_drive(fields, 1, "round")


def test_of_a_drive(vehicle: VehicleSpec) -> None:
    assert estimate_accel_offset(drive_with(0.25), vehicle) == pytest.approx(0.25 / G_MPS2, abs=0.003)
    (words,) = describe_accel_offsets([drive_with(0.25), drive_with(0.0)], vehicle)
    assert words.startswith("round: the accelerometer reads +0.2") and "No hill" in words


def test_a_drive_without_an_accelerometer_or_a_gyro_says_nothing(vehicle: VehicleSpec) -> None:
    drive = drive_with(0.25)
    for name in ("report.accel_mps2", "report.yaw_rate_radps", "report.speed_mps"):
        remaining = {key: one for key, one in drive.fields.items() if key != name}
        assert estimate_accel_offset(drive._replace(fields=remaining), vehicle) == 0.0
