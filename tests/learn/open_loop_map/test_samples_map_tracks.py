"""What counts of a drive: straight, level, forward, by-wire obeying; and what is said where too little does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.learn.made_pedals import DT_S, REST, changed, pedal_drive, some_drive, vehicle
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_NEUTRAL
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.learn.open_loop_map.samples import make_pedal_track, make_pedal_tracks, moving_mean


@given(st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=40), st.integers(1, 9))
def test_the_moving_mean_is_the_mean_of_what_there_is(values: list[float], rows: int) -> None:
    got = moving_mean(np.array(values), rows * DT_S, DT_S)
    for k in range(len(values)):
        near = values[max(0, k - rows // 2) : k + rows - rows // 2]
        assert got[k] == pytest.approx(np.mean(near), abs=1e-9)


def test_a_straight_level_drive_is_good_wherever_it_moves() -> None:
    track = make_pedal_track(some_drive(), vehicle())
    assert np.array_equal(track.is_good, track.is_moving)
    assert track.is_good.mean() > 0.9


def test_bends_slopes_other_gears_and_a_driver_are_left_out() -> None:
    drive, rows = some_drive(), some_drive().n_rows
    quarter = np.arange(rows) // (rows // 4)
    steer = np.where(quarter == 0, 2.0, 0.0)
    lateral = np.where(quarter == 0, 2.5, 0.0)
    slope = np.where(quarter == 1, G_MPS2 * 0.06, 0.0)
    gear = np.where(quarter == 2, GEAR_NEUTRAL, 4.0)
    on = quarter < 3
    bad = changed(
        drive,
        report__steer_rad=steer,
        report__lateral_accel_mps2=lateral,
        report__accel_mps2=drive.fields["report.accel_mps2"] + slope,
        report__gear=gear,
    )._replace(enabled=on | (np.arange(rows) == 0))
    track = make_pedal_track(bad, vehicle())
    for number in range(4):
        share = track.is_good[quarter == number].mean()
        assert share < (0.1 if number == 1 else 0.01), f"quarter {number}: {share}"


def test_a_wheel_off_centre_counts_while_the_car_hardly_turns() -> None:
    drive, rows = some_drive(), some_drive().n_rows
    bent = changed(drive, report__steer_rad=np.full(rows, 0.2))
    assert make_pedal_track(bent, vehicle()).is_good.mean() > 0.9
    turning = changed(bent, report__lateral_accel_mps2=np.full(rows, 1.0))
    assert not make_pedal_track(turning, vehicle()).is_good.any()


def test_a_person_drives_on_the_pedals_not_on_the_commands() -> None:
    drive = some_drive()
    idle = np.full(drive.n_rows, REST)
    manual = changed(drive, command__throttle_frac=idle, command__brake_frac=idle)
    manual = manual._replace(enabled=np.zeros(drive.n_rows, dtype=bool))
    track = make_pedal_track(manual, vehicle())
    assert np.array_equal(track.pedals["throttle"], drive.fields["report.throttle_frac"])
    assert track.is_good.mean() > 0.9


def test_the_rate_of_speed_is_taken_from_the_speed_where_nothing_else_says_it() -> None:
    drive = changed(pedal_drive(30.0), ins__accel_mps2=None, report__accel_mps2=None)
    track = make_pedal_track(drive, vehicle())
    truth = some_drive().fields["ins.accel_mps2"][:3000]
    middle = slice(100, -100)
    error = moving_mean(track.accel_mps2 - truth, 0.5, DT_S)[middle]
    assert np.sqrt(np.mean(error * error)) < 0.15
    assert any("taken as level" in words for words in make_pedal_tracks([drive], vehicle())[1])


def test_what_a_drive_lacks_is_said() -> None:
    drive = some_drive()
    lone = dict.fromkeys(("command__brake_frac", "report__brake_frac"))
    with pytest.raises(InputError, match="neither command nor report of the brake") as caught:
        make_pedal_track(changed(drive, **lone), vehicle())
    assert caught.value.code == "no_pedals" and caught.value.file == "made.log"
    with pytest.raises(InputError, match="no speed"):
        make_pedal_track(changed(drive, report__speed_mps=None), vehicle())
    with pytest.raises(InputError, match=r"too little straight driving: of 2\d\d s moving 0 s are straight"):
        lateral = np.full(drive.n_rows, 2.0)
        make_pedal_tracks([changed(drive, report__steer_rad=lateral, report__lateral_accel_mps2=lateral)], vehicle())
    with pytest.raises(InputError, match="too little driving"):
        make_pedal_tracks([pedal_drive(10.0)], vehicle())
