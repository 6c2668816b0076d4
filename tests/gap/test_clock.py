"""Echoes against the wire: a delay is a delay, and a command that was never sent is found."""

from __future__ import annotations

import pytest

from tests.learn.made_drives import LATE, made_drive
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.gap.chain import open_chain
from tunefree_hil.gap.clock import echoes


def opened(lost: bool = False):
    drive = made_drive(40.0)
    if lost:
        echo = drive.fields["report.steer_command_rad"].copy()
        for begin in range(300, 3900, 400):
            echo[begin : begin + 40] = echo[begin]
        drive = drive._replace(fields={**drive.fields, "report.steer_command_rad": echo})
    return open_chain(drive, load_vehicle("mkz_bywire"))


@pytest.mark.slow
def test_the_transport_is_found_and_nothing_is_strange() -> None:
    found = {one.channel: one for one in echoes(opened())}
    assert found["steer"].late_s == pytest.approx(LATE * 0.01, abs=0.0101)
    assert not any(one.broken for one in found.values())


@pytest.mark.slow
def test_frames_that_are_lost_for_a_while_are_found() -> None:
    found = {one.channel: one for one in echoes(opened(lost=True))}
    assert found["steer"].broken and not found["throttle"].broken
