"""What the nodes noticed, in words, from a file such as the nodes write."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tunefree_hil.jobs.running.episode_results import reception_warnings


def test_each_message_with_trouble_is_a_line(tmp_path: Path) -> None:
    rows = {
        "ecu_late_s": np.zeros(3),
        "ecu_heard_STEERING_CMD": np.array([190, 0, 0, 2, 0, 0, 1, 0]),
        "controller_heard_WHEEL_SPEED": np.array([196, 0, 0, 0, 0, 4, 0, 0]),
        "controller_heard_GEAR_REPORT": np.array([60, 0, 0, 0, 0, 0, 0, 22]),  # of a run before short ones were counted
        "controller_heard_GYRO": np.array([90, 0, 0, 0, 0, 0, 0, 0, 3]),
    }
    np.savez(tmp_path / "timing.npz", allow_pickle=False, **rows)
    assert reception_warnings(tmp_path) == [
        "ecu received STEERING_CMD: 2 wrong sequence",
        "controller received GEAR_REPORT: 22 more frames than are due",
        "controller received GYRO: 3 shorter than the DBC says",
        "controller received WHEEL_SPEED: 4 no new data",
    ]


def test_a_drive_without_times_says_nothing(tmp_path: Path) -> None:
    assert reception_warnings(tmp_path) == []
