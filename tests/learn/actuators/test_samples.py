"""Commands and outputs in one frame of time."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import DT_S, LATE, excitation, made_drive, whole
from tunefree_hil.learn.actuators.samples import BENCH_TICKS, by_echo, has_channel, pairs_of, shift_of
from tunefree_hil.learn.drives.drive import Drive, Part


@pytest.fixture(scope="module")
def drive() -> Drive:
    return made_drive(20.0)


def without(drive: Drive, *names: str) -> Drive:
    return drive._replace(fields={key: one for key, one in drive.fields.items() if key not in names})


def test_the_wire_fills_in_between_two_reports(drive: Drive) -> None:
    pair = pairs_of([whole(drive)], "throttle").some[0]
    truth = np.array([excitation()(k * DT_S).throttle_frac for k in range(drive.ticks)])
    assert np.abs(pair.command - truth)[:-LATE].max() < 2e-5, "also where no report came"
    assert pair.counts.sum() == pytest.approx(drive.ticks / 2 - 50, abs=1)
    assert not pair.counts[1::2].any(), "only fresh outputs are compared"


def test_the_shift_of_the_wire_is_found(drive: Drive) -> None:
    echo, wire = drive.fields["report.brake_command_frac"], drive.fields["command.brake_frac"]
    ticks = np.flatnonzero(drive.fresh["report.brake_command_frac"])
    moved = np.concatenate([np.full(7, np.nan), wire])[: len(wire)]
    assert shift_of(echo, np.nan_to_num(moved, nan=-1.0), ticks, 30) is None, "it would have to come before its echo"
    early = np.concatenate([wire[4:], np.zeros(4)])
    assert shift_of(echo[:-10], early[:-10], ticks[ticks < len(echo) - 10], 30) == LATE + 4


def test_a_wire_that_says_something_else_is_not_used(drive: Drive) -> None:
    echo, fresh = drive.fields["report.throttle_command_frac"], drive.fresh["report.throttle_command_frac"]
    lies = np.random.default_rng(1).uniform(0.2, 0.5, len(echo))
    command = by_echo(echo, fresh, lies, DT_S)
    between = np.flatnonzero(~fresh)[:-1]
    assert command[between] == pytest.approx(0.5 * (echo[between - 1] + echo[between + 1]))


def test_without_an_echo_the_bench_is_believed(drive: Drive) -> None:
    found = pairs_of([whole(without(drive, "report.steer_command_rad"))], "steer")
    assert "no echo" in found.words
    wire = drive.fields["command.steer_rad"]
    assert found.some[0].command[:50] == pytest.approx(wire[:50])
    assert BENCH_TICKS == LATE


def test_no_output_no_pairs(drive: Drive) -> None:
    assert pairs_of([whole(without(drive, "report.steer_rad"))], "steer").some == ()
    assert not has_channel([drive], "steer_torque") and has_channel([drive], "steer")


def test_stretches_end_where_the_channel_does_not_obey(drive: Drive) -> None:
    enabled = drive.enabled.copy()
    enabled[800:900] = False
    some = pairs_of([Part(drive._replace(enabled=enabled), 0, drive.ticks)], "steer").some
    assert [len(pair.command) for pair in some] == [800, drive.ticks - 900]


def test_an_acceleration_is_read_off_the_motion(drive: Drive) -> None:
    asked = np.full(drive.ticks, 0.5)
    fields = {**drive.fields, "command.accel_mps2": asked}
    fresh = {**drive.fresh, "command.accel_mps2": np.ones(drive.ticks, dtype=bool)}
    found = pairs_of([whole(drive._replace(fields=fields, fresh=fresh))], "accel")
    assert found.some[0].window == 51 and "motion" in found.words
    rate = np.gradient(drive.fields["ins.speed_mps"], DT_S)
    middle = slice(300, 1500)
    assert found.some[0].output[middle].mean() == pytest.approx(rate[middle].mean(), abs=0.02)
