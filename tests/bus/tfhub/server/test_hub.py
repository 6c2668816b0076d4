"""The hub: numbers, clocks, roles, hello and good-bye, logs."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from tests.bus.tfhub_help import (
    PATIENCE_S,
    ThreadHub,
    eventually,
    frame,
    hello,
    last_word,
    number_of,
    raw_connection,
    thread_hub,
)
from tunefree_hil.base.errors import InputError, PeerGone
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.tfhub import records
from tunefree_hil.bus.tfhub.plugin import HubBus, MayNotSend


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[ThreadHub]:
    with thread_hub(tmp_path) as running:
        yield running


def test_one_order_over_both_channels(hub: ThreadHub) -> None:
    with (
        hub.member("a") as a,
        hub.member("a", "bench") as b,
        raw_connection(hub) as c,
        raw_connection(hub, "bench") as d,
    ):
        for sock, name in ((c, "c"), (d, "d")):
            sock.sendall(hello(name=name))
            size, kind = struct.unpack("<HB", sock.recv(3, socket.MSG_WAITALL))
            assert kind == records.WELCOME
            sock.recv(size - 3, socket.MSG_WAITALL)
        heads = []
        for number in range(50):
            (a if number % 2 else b).send_frames([frame(number)] * (1 + number % 3))
            sock, wanted = (c, 1 + number % 3) if number % 2 else (d, 1 + number % 3)
            while wanted:
                size, kind = struct.unpack("<HB", sock.recv(3, socket.MSG_WAITALL))
                rest = sock.recv(size - 3, socket.MSG_WAITALL)
                if kind == records.FRAME:
                    heads.append(struct.unpack_from("<BQQ", rest))
                    wanted -= 1
        sequences = [sequence for _, sequence, _ in heads]
        assert sequences == list(range(1, len(heads) + 1))
        stamps = [time_ns for _, _, time_ns in heads]
        assert stamps == sorted(stamps)
        assert len({index for index, _, _ in heads}) == 2


def test_the_real_clock_is_monotonic_for_us_and_a_date_for_others(hub: ThreadHub) -> None:
    with hub.member("a") as a, hub.member("b") as b, hub.observer("c") as c:
        before_s = time.monotonic()
        a.send_frames([CanFrame(1, b"", False, False, 5.0)])
        stamp_s = b.recv_frames(PATIENCE_S)[0].time_s
        assert before_s <= stamp_s <= time.monotonic()
        message = c.recv(PATIENCE_S)
        assert message is not None and abs(message.timestamp - stamp_s - hub_offset_s(hub)) < 1e-6
        assert message.timestamp > 1.7e9


def hub_offset_s(hub: ThreadHub) -> float:
    with hub.observer("probe") as probe:
        return probe.welcome.epoch_offset_ns / 1e9


def test_the_senders_clock(tmp_path: Path) -> None:
    with thread_hub(tmp_path, clock="sender") as hub, hub.member("ecu", stamps=True) as ecu:
        visitor, reader = hub.member("visitor"), hub.member("reader")
        with visitor, reader:
            ecu.send_frames([CanFrame(1, b"", False, False, 0.03), CanFrame(2, b"", False, False, 0.04)])
            assert [found.time_s for found in reader.recv_frames(PATIENCE_S)] == [0.03, 0.04]
            visitor.send_frames([CanFrame(3, b"", False, False, 9.0)])
            assert reader.recv_frames(PATIENCE_S)[0].time_s == 0.04  # the latest virtual time, not his own
            ecu.send_frames([CanFrame(1, b"", False, False, 0.0)])  # the next episode
            assert reader.recv_frames(PATIENCE_S)[0].time_s == 0.0
            ecu.send(can.Message(arbitration_id=1, timestamp=0.07, is_extended_id=False))
            message = reader.recv(PATIENCE_S)
            assert message is not None and message.timestamp == 0.07


def test_names(hub: ThreadHub) -> None:
    with hub.member("ecu") as ecu, hub.member("ecu", "bench"):  # one name on both channels is one node
        with pytest.raises(InputError, match="ecu is on the bus already") as raised:
            hub.member("ecu")
        assert raised.value.code == "duplicate_name"
        with pytest.raises(InputError, match="ecu is on the bus already"):
            hub.observer("ecu")
        assert ecu.name == "ecu"
    with hub.member("ecu"):  # free again after a good-bye
        pass
    with HubBus(hub.vehicle) as first, HubBus(hub.vehicle) as second:  # names of nobody's choice are made to fit
        assert second.name == f"{first.name}-2"


def test_a_loss_is_told_once_a_process_and_the_bus_goes_on(hub: ThreadHub) -> None:
    lost = [hub.member("ecu"), hub.member("ecu", "bench")]
    with hub.member("a") as a, hub.member("a", "bench") as bench, hub.observer("o") as o, hub.member("b") as b:
        lost[0].send_frames([frame(1)])
        for bus in lost:
            bus._connection.sock.close()  # as a crash does: no good-bye
        assert number_of(a.recv_frames(PATIENCE_S)[0].data) == 1  # what it had sent comes first
        for bus in (a, bench, b):
            if bus is b:
                b.recv_frames(PATIENCE_S)
            with pytest.raises(PeerGone, match="ecu is gone") as raised:
                bus.recv(PATIENCE_S)
            assert raised.value.peer == "ecu"
        assert [bus.recv(0.05) for bus in (a, bench, b)] == [None, None, None]
        assert o.recv(PATIENCE_S) is not None and o.recv(0.05) is None  # observers are not told
        a.send_frames([frame(2)])
        assert number_of(b.recv_frames(PATIENCE_S)[0].data) == 2
        assert len([line for line in hub.owner.stats().lost if "ecu" in line]) == 1
    for bus in lost:
        bus.shutdown()


def test_a_loss_and_the_return_of_one_name(hub: ThreadHub) -> None:
    with hub.member("a") as a:
        for _ in range(2):
            ecu = hub.member("ecu")
            ecu._connection.sock.close()
            with pytest.raises(PeerGone):
                a.recv_frames(PATIENCE_S)
            ecu.shutdown()


def test_a_good_bye_is_no_loss(hub: ThreadHub) -> None:
    with hub.member("a") as a:
        with hub.member("b") as b:
            b.send_frames([frame(n) for n in range(100)])
        with hub.observer("o") as o:
            o._connection.sock.close()
        assert len(a.recv_frames(PATIENCE_S)) == 100
        eventually(lambda: len(hub.owner.stats().peers) == 2)
        assert a.recv(0.05) is None


def test_an_observer_may_not_send(hub: ThreadHub) -> None:
    with hub.observer("o") as o, hub.member("a") as a, raw_connection(hub) as sock:
        with pytest.raises(MayNotSend, match="role=member"):
            o.send(can.Message(arbitration_id=1))
        with pytest.raises(can.CanOperationError):
            o.send_frames([frame(1)])
        sock.sendall(hello(name="sly", role="observer") + records.pack_frames([frame(1)]))
        assert "it sent frames as observer" in last_word(sock)["message"]
        assert a.recv(0.05) is None


def test_a_member_that_only_talks_holds_nobody_up(hub: ThreadHub) -> None:
    with hub.member("talker", listen=False), hub.member("a") as a:
        for _ in range(100):
            a.send_frames([frame(n) for n in range(1000)], PATIENCE_S)
        assert hub.owner.stats().held_by == ()
