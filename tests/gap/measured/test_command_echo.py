"""Echoes against the wire: a delay is a delay, and a command that was never sent is found."""

from __future__ import annotations

import numpy as np
import pytest

from tests.learn.made_drives import DT_S, LATE, made_drive
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.gap.measured.chain import MeasuredDrive, build_measured_drive
from tunefree_hil.gap.measured.command_echo import check_echoes
from tunefree_hil.gap.measured.signals import signal_from_values
from tunefree_hil.learn.drives.drive import Drive


def opened(lost: bool = False):
    drive = made_drive(40.0)
    if lost:
        echo = drive.fields["report.steer_command_rad"].copy()
        for begin in range(300, 3900, 400):
            echo[begin : begin + 40] = echo[begin]
        drive = drive._replace(fields={**drive.fields, "report.steer_command_rad": echo})
    return build_measured_drive(drive, load_vehicle("mkz_bywire"))


@pytest.mark.slow
def test_the_transport_is_found_and_nothing_is_strange() -> None:
    found = {one.channel: one for one in check_echoes(opened())}
    assert found["steer"].delay_s == pytest.approx(LATE * 0.01, abs=0.0101)
    assert not any(one.is_broken for one in found.values())


@pytest.mark.slow
def test_frames_that_are_lost_for_a_while_are_found() -> None:
    found = {one.channel: one for one in check_echoes(opened(lost=True))}
    assert found["steer"].is_broken and not found["throttle"].is_broken


@pytest.mark.parametrize(("period", "lost"), [(1, False), (5, False), (10, False), (5, True)])
def test_slow_commands_are_no_lost_frames(period: int, lost: bool) -> None:
    found = {one.channel: one for one in check_echoes(sent(period, lost))}
    assert found["steer"].is_broken == lost


def test_commands_that_nobody_recorded_are_no_lost_frames() -> None:
    """The tap was away for two seconds: what the by-wire unit obeyed then is not on the wire of this log."""
    whole = sent(1, lost=False)
    wire = whole.signals["command.steer_rad"]
    fresh = wire.fresh.copy()
    for begin in range(500, 2500, 600):
        fresh[begin : begin + 200] = False
    gaps = signal_from_values(np.where(fresh, wire.values, np.nan), fresh, DT_S)
    steer, *_ = check_echoes(whole._replace(signals={**whole.signals, "command.steer_rad": gaps}))
    assert not steer.is_broken and steer.rows < 2000 and steer.delay_s == pytest.approx(0.07)


def sent(period: int, lost: bool, ticks: int = 3000, late: int = 7) -> MeasuredDrive:
    """Commands of every so many ticks, obeyed `late` ticks after they were sent; lost: for a while now and then."""
    time_s = DT_S * np.arange(ticks)
    command = 0.4 * np.sin(2.0 * np.pi * 0.4 * time_s) + 0.1 * np.sin(2.0 * np.pi * 1.3 * time_s)
    newest = np.arange(ticks) // period * period
    wire = command[newest]
    echo = np.concatenate([np.full(late, wire[0]), wire[:-late]])
    if lost:
        for begin in range(300, ticks - 100, 400):
            echo[begin : begin + 40] = echo[begin]
    fields = {"report.speed_mps": np.full(ticks, 10.0), "report.yaw_rate_radps": 0.1 * command,
              "report.steer_rad": echo, "report.steer_command_rad": echo, "command.steer_rad": wire}  # fmt: skip
    fresh = {name: np.ones(ticks, dtype=bool) for name in fields}
    fresh["command.steer_rad"] = np.arange(ticks) % period == 0
    drive = Drive("made", f"sha256:{1:064x}", DT_S, fields, fresh, np.ones(ticks, dtype=bool))
    return build_measured_drive(drive, load_vehicle("mkz_bywire"))
