"""An ECU that drives by itself in real time answers whoever sends command frames: cansend, canplayer, this test."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.bus.tfhub_help import thread_hub
from tunefree_hil.base.records import CanFrame, Command
from tunefree_hil.bench import load
from tunefree_hil.bus.dbc.codec import Codec, Snapshot
from tunefree_hil.jobs.ecu import ecu
from tunefree_hil.jobs.options.nodes import EcuOptions, NodeLink

STEER_RAD = 0.4


def commands(codec: Codec, count: int) -> list[CanFrame]:
    """The command frames of cycle `count`, enabled, as a player of a log would send them."""
    command = Command(throttle_frac=0.2, brake_frac=0.15, steer_rad=STEER_RAD, gear=4.0)
    frames = []
    for message in codec.commands:
        signals = {message.enable: 1.0} if message.enable else {}
        if message.counter:
            signals[message.counter] = float(count % 256)
        frames.append(CanFrame(message.can_id, codec.encode(message, {"command": command}, signals)))
    return frames


@pytest.mark.slow
def test_it_follows_commands_that_no_controller_of_ours_sends(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path, duration_s=1.5))
    told: list[str] = []

    def serve(session: str) -> None:
        for event in ecu(tmp_path / "b.toml", EcuOptions(scenario="tiny"), NodeLink("tfhub", session=session)):
            told.append(event.data.get("sentence") or event.message)

    with thread_hub(tmp_path) as hub, hub.member("player") as player:
        node = threading.Thread(target=serve, args=(hub.session,))
        node.start()
        snapshot, turned, cycles = Snapshot(bench.codec), 0.0, 0
        while node.is_alive():
            for frame in player.recv_frames(0.01):
                message = bench.codec.by_id.get(frame.id)
                if message is not None:
                    snapshot.take(message, frame.data)
            turned = max(turned, snapshot.report().steer_rad or 0.0)
            player.send_frames(commands(bench.codec, cycles))
            cycles += 1
        node.join()
    assert turned == pytest.approx(STEER_RAD, abs=0.1)
    assert "starts now" in told[-2]
    heard = int(told[-1].split(";")[1].split()[0])
    assert "tiny driven to its end" in told[-1] and heard > 40
