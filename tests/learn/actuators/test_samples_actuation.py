"""The actuation of a car: the command where it is obeyed, and the recorded output where a person drives."""

from __future__ import annotations

import numpy as np

from tests.learn.made_drives import made_drive
from tunefree_hil.learn.actuators.samples import CHANNELS, read_actuation


def test_a_person_moves_the_output_while_the_echo_rests() -> None:
    drive = made_drive(20.0, seed=3)
    by_hand = np.arange(drive.n_rows) > 1000
    for name in ("throttle", "brake", "steer"):
        _, output, obeyed = read_actuation(drive._replace(enabled=~by_hand), name, 0.0)
        assert not obeyed[by_hand].any() and obeyed[~by_hand].all() and np.isfinite(output).all()


def test_without_a_recorded_output_the_echo_is_all_there_is() -> None:
    drive = made_drive(20.0, seed=3)
    fields = {key: one for key, one in drive.fields.items() if key != f"report.{CHANNELS['steer']}"}
    _, output, obeyed = read_actuation(drive._replace(fields=fields, enabled=drive.enabled & False), "steer", 0.0)
    assert np.isnan(output).all() and obeyed.all()
