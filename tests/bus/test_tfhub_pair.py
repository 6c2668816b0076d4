"""Both channels over one connection: the same frames, in the same order, with the same promises as two connections."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.bus.tfhub_help import PATIENCE_S, ThreadHub, eventually
from tunefree_hil.base.errors import BenchError, InputError, PeerGone
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.link import Links, PairLink
from tunefree_hil.bus.open import BusChoice, LinkRequest, open_link, open_links
from tunefree_hil.bus.tfhub.pair import HubPair
from tunefree_hil.bus.tfhub.plugin import HubBus
from tunefree_hil.bus.tfhub.records import FRAME, KIND_AT, SECOND_FRAME, mark_second_channel, pack_frames, select_ids


@pytest.fixture(params=["unix", "tcp"])
def hub(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[ThreadHub]:
    running = ThreadHub(tmp_path, transport=request.param)
    yield running
    running.owner.close()


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as found:
        yield found


def choice_of(hub: ThreadHub) -> BusChoice:
    return BusChoice("tfhub", f"tfhub:{hub.vehicle}", f"tfhub:{hub.bench}", "")


def joined(hub: ThreadHub, stack: ExitStack, name: str) -> Links:
    links = open_links(choice_of(hub), LinkRequest(name=name, stamps=True))
    stack.callback(links.close)
    assert isinstance(links.vehicle, PairLink)
    return links


def frames_of(first: int, count: int, **more: object) -> list[CanFrame]:
    return [CanFrame(0x100 + i % 8, bytes([i % 256]) * 8)._replace(**more) for i in range(first, first + count)]


def read(link: PairLink | HubBus, count: int) -> list[CanFrame]:
    got: list[CanFrame] = []
    while len(got) < count:
        more = link.receive(PATIENCE_S) if hasattr(link, "receive") else link.recv_frames(PATIENCE_S)
        assert more, f"{len(got)} of {count} frames came"
        got += more
    return got


def plain(frames: list[CanFrame]) -> list[tuple[int, bytes, bool]]:
    return [(frame.id, frame.data, frame.fd) for frame in frames]


def test_each_channel_gets_its_own_frames_in_order(hub, stack):
    ecu, controller = joined(hub, stack, "ecu"), joined(hub, stack, "controller")
    alone = HubBus(hub.vehicle, role="member", name="alone")
    stack.callback(alone.shutdown)
    vehicle, bench = frames_of(0, 40), frames_of(100, 3, id=0x6E0)
    ecu.send_both(vehicle, bench)
    assert plain(read(controller.bench, 3)) == plain(bench)
    assert plain(read(controller.vehicle, 40)) == plain(vehicle)
    assert plain(read(alone, 40)) == plain(vehicle)
    assert alone.recv_frames(0.05) == [] and ecu.vehicle.receive(0.05) == []
    alone.send_frames(vehicle[:2])
    assert plain(read(ecu.vehicle, 2)) == plain(vehicle[:2]) == plain(read(controller.vehicle, 2))
    assert controller.bench.receive(0.05) == []


def test_fd_remote_and_error_frames_take_the_slow_path(hub, stack):
    node = joined(hub, stack, "node")
    bus = HubBus(hub.vehicle, role="member", name="tool")
    stack.callback(bus.shutdown)
    bus.send(can.Message(arbitration_id=0x1, is_remote_frame=True, is_extended_id=False, dlc=3))
    bus.send(can.Message(is_error_frame=True, arbitration_id=0x10))
    fd = CanFrame(0x18FF0011, bytes(range(64)), extended=True, fd=True)
    bus.send_frames([fd, CanFrame(0x7, b"ab")])
    assert plain(read(node.vehicle, 2)) == [(fd.id, fd.data, True), (0x7, b"ab", False)]
    bus.send(can.Message(is_error_frame=True, arbitration_id=0x40))
    with pytest.raises(BenchError, match="is bus-off"):
        read(node.vehicle, 1)
    node.send_both([fd], [CanFrame(0x6E0, b"1")])
    assert plain(bus.recv_frames(PATIENCE_S)) == plain([fd])


def test_a_burst_with_a_sleeping_reader_loses_nothing(hub, stack):
    sender, reader = joined(hub, stack, "sender"), joined(hub, stack, "reader")
    for first in range(0, 20_000, 500):
        sender.send_both(frames_of(first, 400), frames_of(first, 100))
    assert len(read(reader.vehicle, 16_000)) == 16_000
    assert len(read(reader.bench, 4_000)) == 4_000


def test_a_lost_member_is_named_and_a_name_is_taken_on_both_channels(hub, stack):
    node = joined(hub, stack, "node")
    with pytest.raises(InputError, match="on the bus already"):
        HubBus(hub.bench, role="member", name="node")
    with pytest.raises(InputError, match="on the bus already"):
        HubPair(hub.vehicle, name="node")
    lost = HubPair(hub.vehicle, name="lost")
    lost._connection.sock.close()
    with pytest.raises(PeerGone, match="lost"):
        node.bench.receive(PATIENCE_S)
    eventually(lambda: len(hub.owner.stats().peers) <= 2)


def test_what_is_prepared_waits_for_its_call(hub, stack):
    ecu, controller = joined(hub, stack, "ecu"), joined(hub, stack, "controller")
    vehicle, bench = frames_of(0, 3), frames_of(100, 2, id=0x6E0)
    send, nothing = ecu.prepare(vehicle, bench), ecu.prepare([], [])
    nothing()
    ecu.vehicle.send(frames_of(50, 1))
    send()
    assert plain(read(controller.vehicle, 4)) == plain(frames_of(50, 1) + vehicle)
    assert plain(read(controller.bench, 2)) == plain(bench)


def test_only_what_one_wants(hub, stack):
    node = joined(hub, stack, "node")
    runner = open_link(choice_of(hub), "bench", LinkRequest(name="runner", only=(0x6E2,)))
    stack.callback(runner.close)
    node.send_both([], [CanFrame(0x6E0, b"tick"), CanFrame(0x6E1, b"done")])
    node.send_both([], [CanFrame(0x6E2, b"stat"), CanFrame(0x6E1, b"done")])
    got = runner.receive(PATIENCE_S)
    assert [(frame.id, frame.data) for frame in got] == [(0x6E2, b"stat")]


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=64)), max_size=20), st.integers(0, 0x7FF))
def test_records_are_marked_and_searched(content, wanted):
    frames = [CanFrame(number, data, False, len(data) > 8) for number, data in content]
    data = pack_frames(frames)
    marked = mark_second_channel(data, len(frames))
    assert len(marked) == len(data)
    at, differing = 0, 0
    while at < len(data):
        assert data[at + KIND_AT] == FRAME and marked[at + KIND_AT] == SECOND_FRAME
        differing += 1
        at += data[at] | data[at + 1] << 8
    assert differing == sum(one != other for one, other in zip(data, marked, strict=True))
    kept = [frame for frame in frames if frame.id == wanted]
    assert b"".join(select_ids(data, len(frames), frozenset([wanted]))) == pack_frames(kept)
