"""A value is valid only if it was received recently: gaps, messages that stop, messages on demand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import made_drive
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.learn.drives.drive import Drive, DrivePart
from tunefree_hil.learn.drives.validity import drop_incomplete_drives, interpolate_pose, is_on_demand, valid_rows
from tunefree_hil.learn.evaluation import motion
from tunefree_hil.learn.open_loop_map import samples
from tunefree_hil.learn.physics.windows import extract_windows

VEHICLE = load_vehicle("mkz_bywire")
SPEED = "report.speed_mps"


def silent(drive: Drive, begin: int, end: int, *names: str) -> Drive:
    """The drive without frames of these fields in some rows, where they keep their last values."""
    fields, fresh = dict(drive.fields), dict(drive.fresh)
    for name in names or fields:
        fields[name], fresh[name] = fields[name].copy(), fresh[name].copy()
        fields[name][begin:end] = fields[name][begin - 1]
        fresh[name][begin:end] = False
    return drive._replace(fields=fields, fresh=fresh)


@pytest.fixture(scope="module")
def drive() -> Drive:
    return made_drive(60.0, seed=5)


def test_nothing_is_learned_from_a_gap_of_the_recording(drive: Drive) -> None:
    gap = silent(drive, 2000, 2600)
    for variant, is_used in ((drive, True), (gap, False)):
        whole = DrivePart(variant, 0, variant.n_rows)
        assert motion.make_motion_track(whole, VEHICLE).is_good[2010:2590].any() == is_used
    assert not samples.make_pedal_track(gap, VEHICLE).is_good[2010:2590].any()
    assert motion.make_motion_track(DrivePart(gap, 0, gap.n_rows), VEHICLE).is_good[1000:1990].all(), "all else is used"


@pytest.mark.parametrize("name", ["report.throttle_frac", "ins.speed_mps"])
def test_no_window_is_cut_where_a_message_has_died(drive: Drive, name: str) -> None:
    dead = silent(drive, 4000, drive.n_rows, name)
    begins = [one.begin for one in extract_windows([DrivePart(dead, 0, dead.n_rows)], VEHICLE).windows]
    assert begins and max(begins) < 4000


def test_an_ins_that_speaks_seldom_gives_way_to_the_chassis(drive: Drive) -> None:
    seldom = drive.fresh["ins.speed_mps"] & (np.arange(drive.n_rows) % 100 == 0)
    slow = drive._replace(fresh={**drive.fresh, "ins.speed_mps": seldom})
    assert len(extract_windows([DrivePart(slow, 0, slow.n_rows)], VEHICLE).windows) > 2


def test_a_message_on_demand_holds_between_two_demands(drive: Drive) -> None:
    rows = np.arange(drive.n_rows)
    on_demand = drive._replace(fresh={**drive.fresh, SPEED: (rows % 1000 < 200) & drive.fresh[SPEED]})
    assert valid_rows(on_demand, SPEED).all()
    assert not valid_rows(silent(drive, 3000, 5000, SPEED), SPEED)[3000:4990].any()
    assert not is_on_demand(np.ones(9, dtype=bool))


def test_a_pose_between_two_frames_is_on_the_way(drive: Drive) -> None:
    tenth = {name: drive.fresh[name] & (np.arange(drive.n_rows) % 10 == 0) for name in drive.fresh}
    slow = drive._replace(fresh={**drive.fresh, **{name: tenth[name] for name in ("ins.x_m", "ins.y_m")}})
    for exact, interpolated in zip(interpolate_pose(drive), interpolate_pose(slow), strict=True):
        good = np.isfinite(exact) & np.isfinite(interpolated)
        good[-10:] = False  # behind the last frame
        assert good.sum() > 5000 and np.abs(exact - interpolated)[good].max() < 0.05


def test_a_drive_that_says_nothing_of_the_steering_is_left_out_where_others_do(drive: Drive) -> None:
    steering = {name for name in drive.fields if "steer" in name}
    mute = drive._replace(name="mute", fields={key: one for key, one in drive.fields.items() if key not in steering})
    complete, (message,) = drop_incomplete_drives([drive, mute])
    assert complete == [drive] and message.startswith("mute is left out") and "no steer data" in message
    assert drop_incomplete_drives([mute, mute]) == ([mute, mute], [])
    throttle = {key: one for key, one in drive.fields.items() if "throttle" not in key}
    assert len(drop_incomplete_drives([mute, drive._replace(fields=throttle)])[0]) == 2, "none says all"
