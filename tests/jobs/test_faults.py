"""Scripted faults over real processes: they reach the bus, are named by who hears them, and replay bit for bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.bench.tiny import write_bench
from tests.jobs.command import tunefree, tunefree_alone
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.dbc.integrity import E2eStatus
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.jobs.running.episode_results import reception_warnings

pytestmark = pytest.mark.slow

SCRIPT = """
[[faults]]
kind = "delay"
message = "WHEEL_SPEED"
from_tick = 20
to_tick = 30
value = 4
[[faults]]
kind = "corrupt"
message = "MISC_CMD"
from_tick = 20
to_tick = 60
value = 3
seed = 5
[[faults]]
kind = "burst"
message = "GEAR_REPORT"
from_tick = 30
to_tick = 60
value = 4
[[faults]]
kind = "counter_offset"
message = "STEERING_CMD"
from_tick = 100
to_tick = 110
value = 7
"""


def test_faults_over_the_bus_replay_bit_for_bit(tmp_path: Path) -> None:
    bench = write_bench(tmp_path, more=SCRIPT)
    done = tunefree_alone("drive", bench, "--out", tmp_path / "runs", "--json")
    assert done.status == 0, done.words
    run = Path(done.data["run"])
    log = read_candump(run / "episodes" / "0" / "bench.log")
    words = [bc.decode(CanFrame(one.can_id, one.data)) for one in log]
    begun = [(one.role, one.index, one.tick) for one in words if isinstance(one, bc.Fault) and one.index < 255]
    assert begun == [(2, 1, 20), (1, 0, 20), (1, 2, 30), (2, 3, 100)]
    with np.load(run / "episodes" / "0" / "timing.npz") as data:
        assert data["ecu_heard_STEERING_CMD"][E2eStatus.WRONG_SEQUENCE] == 2, "there and back"
        assert data["controller_heard_WHEEL_SPEED"][E2eStatus.NO_NEW_DATA] == 4, "each tick of the delay"
        assert data["controller_heard_GEAR_REPORT"][len(E2eStatus)] > 10, "more than are due"
    assert "ecu received STEERING_CMD: 2 wrong sequence" in reception_warnings(run / "episodes" / "0")
    told = (run / "nodes" / "ecu.txt").read_text()
    assert "ecu: tick 100: STEERING_CMD: wrong sequence" in told
    again = tunefree("replay", run, "--verify")
    assert again.status == 0, again.words
