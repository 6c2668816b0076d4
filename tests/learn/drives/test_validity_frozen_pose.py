"""An INS that repeats itself while the car drives says no place there; one that stands, or is slow, does."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import made_drive
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.learn.drives.drive import Drive, Part
from tunefree_hil.learn.drives.validity import PLACE, without_held_pose
from tunefree_hil.learn.evaluation import motion


@pytest.fixture(scope="module")
def drive() -> Drive:
    return made_drive(60.0, seed=5)


def held(drive: Drive, begin: int, end: int) -> Drive:
    fields = {name: values.copy() for name, values in drive.fields.items()}
    for name in PLACE:
        fields[name][begin:end] = fields[name][begin]
    return drive._replace(fields=fields)


def test_a_pose_that_stands_while_it_drives_is_left_out(drive: Drive) -> None:
    found, seconds = without_held_pose(held(drive, 2000, 3500))
    assert 13.0 < seconds <= 15.0
    rows = np.isnan(found.fields["ins.x_m"])
    assert not rows[:2000].any() and not rows[3500:].any() and not found.fresh["ins.y_m"][rows].any()
    good = motion.track_of(Part(found, 0, found.ticks), load_vehicle("mkz_bywire")).good
    assert not good[2100:3400].any() and good[1000:1900].all()


def test_a_drive_as_it_is_and_one_of_a_slow_ins_stay(drive: Drive) -> None:
    assert without_held_pose(drive) == (drive, 0.0)
    rows = np.arange(drive.ticks) // 100 * 100
    slow = drive._replace(
        fields={**drive.fields, **{name: drive.fields[name][rows] for name in PLACE}},
        fresh={**drive.fresh, **{name: np.arange(drive.ticks) % 100 == 0 for name in PLACE}},
    )
    assert without_held_pose(slow)[1] == 0.0


def test_a_car_that_stands_says_one_place_and_rightly(drive: Drive) -> None:
    one = held(drive, 2000, 3500)
    still = {"report.speed_mps": one.fields["report.speed_mps"].copy()}
    still["report.speed_mps"][2000:3500] = 0.0
    assert without_held_pose(one._replace(fields={**one.fields, **still}))[1] == 0.0
