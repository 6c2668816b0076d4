"""The hub names who sends a vehicle's ids without being a node of the bench."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from tests.bus.tfhub_help import ThreadHub, eventually, thread_hub
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.tfhub.owner import ForeignSender
from tunefree_hil.bus.tfhub.pair import HubPair

EFF = 0x80000000


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[ThreadHub]:
    with thread_hub(tmp_path) as running:
        yield running


def routed(hub: ThreadHub, count: int) -> None:
    eventually(lambda: hub.owner.stats().frames["vehicle"] >= count)


def test_a_member_of_the_vehicle_channel_alone_is_a_stranger(hub: ThreadHub) -> None:
    hub.owner.guard({0x60, 0x61 | EFF})
    with hub.member("player") as player:
        player.send_frames([CanFrame(0x60, b"a"), CanFrame(0x61, b""), CanFrame(0x62, b""), CanFrame(0x60, b"b")])
        player.send_frames([CanFrame(0x61, bytes(20), extended=True, fd=True)])
        routed(hub, 5)
        found = hub.owner.foreign_senders()
    pid = found[0].pid
    assert found == [ForeignSender("player", pid, 0x60, 2), ForeignSender("player", pid, 0x61 | EFF, 1)]


def test_a_process_on_both_channels_is_a_node(hub: ThreadHub) -> None:
    hub.owner.guard({0x60})
    with hub.member("ecu") as vehicle, hub.member("ecu", "bench"):
        vehicle.send_frames([CanFrame(0x60, b"")])
        routed(hub, 1)
        assert hub.owner.foreign_senders() == []


def test_a_joint_connection_is_a_node(hub: ThreadHub) -> None:
    hub.owner.guard({0x60})
    pair = HubPair(hub.vehicle, name="controller")
    pair.send([CanFrame(0x60, b"")], [])
    routed(hub, 1)
    assert hub.owner.foreign_senders() == []
    pair.close()


def test_remote_frames_are_no_commands_and_a_new_guard_forgets(hub: ThreadHub) -> None:
    hub.owner.guard({0x60})
    with hub.member("player") as player:
        player.send(can.Message(arbitration_id=0x60, is_extended_id=False, is_remote_frame=True, dlc=2))
        player.send_frames([CanFrame(0x60, b"")])
        routed(hub, 2)
        assert [one.count for one in hub.owner.foreign_senders()] == [1]
        hub.owner.guard({0x60})
        assert hub.owner.foreign_senders() == []
        hub.owner.guard(set())
        player.send_frames([CanFrame(0x60, b"")])
        routed(hub, 3)
        assert hub.owner.foreign_senders() == []


def test_what_was_sent_is_known_after_the_sender_has_gone(hub: ThreadHub) -> None:
    hub.owner.guard({0x60})
    with hub.member("gone") as player:
        player.send_frames([CanFrame(0x60, b"")])
        routed(hub, 1)
    assert [one.name for one in hub.owner.foreign_senders()] == ["gone"]
