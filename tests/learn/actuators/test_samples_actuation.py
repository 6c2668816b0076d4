"""What acted on a car: the command where it is obeyed, and where a person drives what the actuator did."""

from __future__ import annotations

import numpy as np

from tests.learn.made_drives import made_drive
from tunefree_hil.learn.actuators.samples import CHANNELS, channel_of


def test_a_person_moves_the_output_while_the_echo_rests() -> None:
    drive = made_drive(20.0, seed=3)
    by_hand = np.arange(drive.ticks) > 1000
    for name in ("throttle", "brake", "steer"):
        _, output, obeyed = channel_of(drive._replace(enabled=~by_hand), name, 0.0)
        assert not obeyed[by_hand].any() and obeyed[~by_hand].all() and np.isfinite(output).all()


def test_without_a_recorded_output_the_echo_is_all_there_is() -> None:
    drive = made_drive(20.0, seed=3)
    fields = {key: one for key, one in drive.fields.items() if key != f"report.{CHANNELS['steer']}"}
    _, output, obeyed = channel_of(drive._replace(fields=fields, enabled=drive.enabled & False), "steer", 0.0)
    assert np.isnan(output).all() and obeyed.all()
