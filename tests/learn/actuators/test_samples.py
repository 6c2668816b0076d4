"""Commands and outputs on one time base."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import DT_S, LATE, excitation, made_drive, whole
from tunefree_hil.learn.actuators.samples import (
    BENCH_TICKS,
    collect_samples,
    command_from_echo,
    find_wire_shift,
    has_channel,
)
from tunefree_hil.learn.drives.drive import Drive, DrivePart


@pytest.fixture(scope="module")
def drive() -> Drive:
    return made_drive(20.0)


def without(drive: Drive, *names: str) -> Drive:
    return drive._replace(fields={key: one for key, one in drive.fields.items() if key not in names})


def test_the_wire_fills_in_between_two_reports(drive: Drive) -> None:
    pair = collect_samples([whole(drive)], "throttle").segments[0]
    truth = np.array([excitation()(k * DT_S).throttle_frac for k in range(drive.n_rows)])
    assert np.abs(pair.command - truth)[:-LATE].max() < 2e-5, "also where no report came"
    assert pair.is_compared.sum() == pytest.approx(drive.n_rows / 2 - 50, abs=1)
    assert not pair.is_compared[1::2].any(), "only fresh outputs are compared"


def test_the_shift_of_the_wire_is_found(drive: Drive) -> None:
    echo, wire = drive.fields["report.brake_command_frac"], drive.fields["command.brake_frac"]
    ticks = np.flatnonzero(drive.fresh["report.brake_command_frac"])
    moved = np.concatenate([np.full(7, np.nan), wire])[: len(wire)]
    assert find_wire_shift(echo, np.nan_to_num(moved, nan=-1.0), ticks, 30) is None, (
        "it would have to come before its echo"
    )
    early = np.concatenate([wire[4:], np.zeros(4)])
    assert find_wire_shift(echo[:-10], early[:-10], ticks[ticks < len(echo) - 10], 30) == LATE + 4


def test_a_wire_that_says_something_else_is_not_used(drive: Drive) -> None:
    echo, fresh = drive.fields["report.throttle_command_frac"], drive.fresh["report.throttle_command_frac"]
    lies = np.random.default_rng(1).uniform(0.2, 0.5, len(echo))
    command = command_from_echo(echo, fresh, lies, DT_S)
    between = np.flatnonzero(~fresh)[:-1]
    assert command[between] == pytest.approx(0.5 * (echo[between - 1] + echo[between + 1]))


def test_without_an_echo_the_bench_is_believed(drive: Drive) -> None:
    samples = collect_samples([whole(without(drive, "report.steer_command_rad"))], "steer")
    assert "no echo" in samples.description
    wire = drive.fields["command.steer_rad"]
    assert samples.segments[0].command[:50] == pytest.approx(wire[:50])
    assert BENCH_TICKS == LATE


def test_no_output_no_pairs(drive: Drive) -> None:
    assert collect_samples([whole(without(drive, "report.steer_rad"))], "steer").segments == ()
    assert not has_channel([drive], "steer_torque") and has_channel([drive], "steer")


def test_stretches_end_where_the_channel_does_not_obey(drive: Drive) -> None:
    enabled = drive.enabled.copy()
    enabled[800:900] = False
    segments = collect_samples([DrivePart(drive._replace(enabled=enabled), 0, drive.n_rows)], "steer").segments
    assert [len(pair.command) for pair in segments] == [800, drive.n_rows - 900]


def test_an_acceleration_is_read_off_the_motion(drive: Drive) -> None:
    command = np.full(drive.n_rows, 0.5)
    fields = {**drive.fields, "command.accel_mps2": command}
    fresh = {**drive.fresh, "command.accel_mps2": np.ones(drive.n_rows, dtype=bool)}
    samples = collect_samples([whole(drive._replace(fields=fields, fresh=fresh))], "accel")
    assert samples.segments[0].filter_ticks == 51 and "motion" in samples.description
    rate = np.gradient(drive.fields["ins.speed_mps"], DT_S)
    middle = slice(300, 1500)
    assert samples.segments[0].output[middle].mean() == pytest.approx(rate[middle].mean(), abs=0.02)
