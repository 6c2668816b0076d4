"""What a drive says of a moment is not what was said long before: gaps, messages that die, messages on demand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import made_drive
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.learn.drives.drive import Drive, Part
from tunefree_hil.learn.drives.validity import between_poses, is_on_demand, those_that_say_all, told
from tunefree_hil.learn.evaluation import motion
from tunefree_hil.learn.open_loop_map import samples
from tunefree_hil.learn.physics.windows import windows_of

VEHICLE = load_vehicle("mkz_bywire")
SPEED = "report.speed_mps"


def silent(drive: Drive, begin: int, end: int, *names: str) -> Drive:
    """The drive without these fields' frames in some rows, their last values held."""
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
    for one, there in ((drive, True), (gap, False)):
        whole = Part(one, 0, one.ticks)
        assert motion.track_of(whole, VEHICLE).good[2010:2590].any() == there
    assert not samples.track_of(gap, VEHICLE).good[2010:2590].any()
    assert motion.track_of(Part(gap, 0, gap.ticks), VEHICLE).good[1000:1990].all(), "all else is used"


@pytest.mark.parametrize("name", ["report.throttle_frac", "ins.speed_mps"])
def test_no_window_is_cut_where_a_message_has_died(drive: Drive, name: str) -> None:
    dead = silent(drive, 4000, drive.ticks, name)
    begins = [one.begin for one in windows_of([Part(dead, 0, dead.ticks)], VEHICLE).some]
    assert begins and max(begins) < 4000


def test_an_ins_that_speaks_seldom_gives_way_to_the_chassis(drive: Drive) -> None:
    seldom = drive.fresh["ins.speed_mps"] & (np.arange(drive.ticks) % 100 == 0)
    slow = drive._replace(fresh={**drive.fresh, "ins.speed_mps": seldom})
    assert len(windows_of([Part(slow, 0, slow.ticks)], VEHICLE).some) > 2


def test_a_message_on_demand_holds_between_two_demands(drive: Drive) -> None:
    rows = np.arange(drive.ticks)
    asked = drive._replace(fresh={**drive.fresh, SPEED: (rows % 1000 < 200) & drive.fresh[SPEED]})
    assert told(asked, SPEED).all()
    assert not told(silent(drive, 3000, 5000, SPEED), SPEED)[3000:4990].any()
    assert not is_on_demand(np.ones(9, dtype=bool))


def test_a_pose_between_two_frames_is_on_the_way(drive: Drive) -> None:
    tenth = {name: drive.fresh[name] & (np.arange(drive.ticks) % 10 == 0) for name in drive.fresh}
    slow = drive._replace(fresh={**drive.fresh, **{name: tenth[name] for name in ("ins.x_m", "ins.y_m")}})
    for exact, found in zip(between_poses(drive), between_poses(slow), strict=True):
        good = np.isfinite(exact) & np.isfinite(found)
        good[-10:] = False  # behind the last frame
        assert good.sum() > 5000 and np.abs(exact - found)[good].max() < 0.05


def test_a_drive_that_says_nothing_of_the_steering_is_left_out_where_others_do(drive: Drive) -> None:
    steering = {name for name in drive.fields if "steer" in name}
    mute = drive._replace(name="mute", fields={key: one for key, one in drive.fields.items() if key not in steering})
    kept, (words,) = those_that_say_all([drive, mute])
    assert kept == [drive] and words.startswith("mute says nothing of steer") and "is left out" in words
    assert those_that_say_all([mute, mute]) == ([mute, mute], [])
    throttle = {key: one for key, one in drive.fields.items() if "throttle" not in key}
    assert len(those_that_say_all([mute, drive._replace(fields=throttle)])[0]) == 2, "none says all"
