"""A position that an INS repeats while the car drives is removed; that of a standing car or a slow INS is kept."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import made_drive
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.learn.drives.drive import Drive, DrivePart
from tunefree_hil.learn.drives.validity import POSITION_FIELDS, drop_frozen_position
from tunefree_hil.learn.evaluation import motion


@pytest.fixture(scope="module")
def drive() -> Drive:
    return made_drive(60.0, seed=5)


def freeze_position(drive: Drive, begin: int, end: int) -> Drive:
    fields = {name: values.copy() for name, values in drive.fields.items()}
    for name in POSITION_FIELDS:
        fields[name][begin:end] = fields[name][begin]
    return drive._replace(fields=fields)


def test_a_pose_that_stands_while_it_drives_is_left_out(drive: Drive) -> None:
    result, seconds = drop_frozen_position(freeze_position(drive, 2000, 3500))
    assert 13.0 < seconds <= 15.0
    rows = np.isnan(result.fields["ins.x_m"])
    assert not rows[:2000].any() and not rows[3500:].any() and not result.fresh["ins.y_m"][rows].any()
    good = motion.make_motion_track(DrivePart(result, 0, result.n_rows), load_vehicle("mkz_bywire")).is_good
    assert not good[2100:3400].any() and good[1000:1900].all()


def test_a_drive_as_it_is_and_one_of_a_slow_ins_stay(drive: Drive) -> None:
    assert drop_frozen_position(drive) == (drive, 0.0)
    rows = np.arange(drive.n_rows) // 100 * 100
    slow = drive._replace(
        fields={**drive.fields, **{name: drive.fields[name][rows] for name in POSITION_FIELDS}},
        fresh={**drive.fresh, **{name: np.arange(drive.n_rows) % 100 == 0 for name in POSITION_FIELDS}},
    )
    assert drop_frozen_position(slow)[1] == 0.0


def test_a_car_that_stands_says_one_place_and_rightly(drive: Drive) -> None:
    frozen = freeze_position(drive, 2000, 3500)
    still = {"report.speed_mps": frozen.fields["report.speed_mps"].copy()}
    still["report.speed_mps"][2000:3500] = 0.0
    assert drop_frozen_position(frozen._replace(fields={**frozen.fields, **still}))[1] == 0.0
