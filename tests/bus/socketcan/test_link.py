"""A SocketCAN link over a fake socket: what vcan cannot give (overflow, a full queue, error frames) and what it can."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator

import pytest

from tests.bus.fake_can import FakeSocket, error_frame
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.socketcan import link as module
from tunefree_hil.bus.socketcan.kernel_frames import CLASSIC_FRAME, FD_FRAME, FILTER, pack, pack_filters, unpack
from tunefree_hil.bus.socketcan.link import Options, SocketCanLink, realtime_offset_ns
from tunefree_hil.bus.tfhub.records import EFF_FLAG, RTR_FLAG

FRAMES = [
    CanFrame(0x123, b"\x01\x02"),
    CanFrame(0x18FEF100, bytes(8), True),
    CanFrame(0x7FF, bytes(range(64)), False, True),
]


@pytest.fixture
def sock() -> Iterator[FakeSocket]:
    fake = FakeSocket()
    yield fake
    fake.close()


def link_of(sock: FakeSocket, options: Options = Options()) -> SocketCanLink:  # noqa: B008
    return SocketCanLink(sock, "can9", "ecu", options)


def plain(frames: list[CanFrame]) -> list[CanFrame]:
    return [frame._replace(time_s=0.0) for frame in frames]


def test_frames_come_whole_and_with_the_kernels_stamp(sock: FakeSocket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "realtime_offset_ns", lambda: 500_000_000)
    sock.arrive(*FRAMES)
    found = link_of(sock).receive(1.0)
    assert plain(found) == FRAMES
    assert [frame.time_s for frame in found] == pytest.approx([0.501, 0.502, 0.503])


def test_a_receive_without_frames_ends_in_time(sock: FakeSocket) -> None:
    link = link_of(sock)
    assert link.receive(0.0) == [] and link.receive(0.01) == []


def test_what_is_sent_is_what_the_kernel_takes(sock: FakeSocket) -> None:
    link_of(sock).send(FRAMES)
    assert [len(data) for data in sock.sent] == [CLASSIC_FRAME.size, CLASSIC_FRAME.size, FD_FRAME.size]
    for data, frame in zip(sock.sent, FRAMES, strict=True):
        raw = unpack(data, 0)
        assert (raw.data, raw.fd, bool(raw.can_id & EFF_FLAG)) == (frame.data, frame.fd, frame.extended)
        assert raw.flags == (1 if frame.fd else 0), "CAN FD goes with bit-rate switch"


@pytest.mark.parametrize(
    "frame",
    [CanFrame(0x800, b""), CanFrame(1 << 29, b"", True), CanFrame(1, bytes(9)), CanFrame(1, bytes(65), fd=True)],
)
def test_what_does_not_fit_a_frame_is_refused(frame: CanFrame) -> None:
    with pytest.raises(InputError, match="fit"):
        pack(frame)


# --- losses ------------------------------------------------------------------------------------------------------


def test_an_overflow_is_named_with_its_exact_number(sock: FakeSocket) -> None:
    link = link_of(sock)
    sock.arrive(FRAMES[0])
    sock.drop(17)
    sock.arrive(FRAMES[1])
    with pytest.raises(BenchError, match="17 frames of can9 did not fit the receive queue of ecu") as caught:
        link.receive(1.0)
    assert caught.value.code == "rx_overflow" and "rmem_max" in caught.value.hint
    sock.arrive(FRAMES[0])
    assert plain(link.receive(1.0)) == FRAMES[:1], "told once"
    sock.drop(1)
    sock.arrive(FRAMES[0])
    with pytest.raises(BenchError, match="1 frame of can9"):
        link.receive(1.0)


def test_a_loss_behind_the_last_frame_is_counted_too(sock: FakeSocket) -> None:
    link = link_of(sock)
    sock.arrive(FRAMES[0])
    link.receive(1.0)
    sock.drop(5)
    assert link.lost == 0, "no frame has brought the news"
    assert link.count_lost() == 5
    with pytest.raises(BenchError, match="5 frames"):
        link.require_all()


def test_what_was_lost_before_an_episode_is_forgiven(sock: FakeSocket) -> None:
    link = link_of(sock)
    sock.drop(9)
    link.forgive()
    sock.arrive(FRAMES[0])
    assert plain(link.receive(1.0)) == FRAMES[:1]


def test_an_old_kernel_tells_with_the_next_frame(sock: FakeSocket) -> None:
    sock.memory_known = False
    sock.drop(3)
    link = link_of(sock)
    assert link.count_lost() == 0
    sock.arrive(FRAMES[0])
    with pytest.raises(BenchError, match="3 frames"):
        link.receive(1.0)


def test_frames_that_waited_bring_old_news(sock: FakeSocket) -> None:
    """Each brings the count of when it arrived; the kernel was asked since, and has counted on."""
    link = link_of(sock)
    sock.drop(3)
    sock.arrive(FRAMES[0])
    sock.drop(40)
    link.forgive()
    assert link.lost == 43 and plain(link.receive(1.0)) == FRAMES[:1] and link.lost == 43


def test_the_kernels_counter_comes_round(sock: FakeSocket) -> None:
    """It has 32 bits."""
    link = link_of(sock)
    for drops in ((1 << 31) - 1, (1 << 31) - 1, 7):
        sock.drop(drops)
        assert link.count_lost() == sock.drops
    assert link.lost > 1 << 32


# --- a full transmit queue ---------------------------------------------------------------------------------------


def test_lockstep_asks_a_full_queue_again(sock: FakeSocket) -> None:
    sock.full = 20
    link_of(sock).send(FRAMES)
    assert sock.sent == [pack(frame) for frame in FRAMES]


def test_lockstep_names_a_queue_that_stays_full(sock: FakeSocket) -> None:
    sock.full = 1 << 30
    with pytest.raises(BenchError, match=r"can9 took no frame for 0.02 s: .* \(ENOBUFS\)") as caught:
        link_of(sock, Options(patience_s=0.02)).send(FRAMES)
    assert caught.value.code == "tx_full" and "ip link set can9 txqueuelen 1000" in caught.value.hint


def test_a_report_is_asked_again_for_half_a_period_and_a_command_not_at_all(sock: FakeSocket) -> None:
    reports = link_of(sock, Options(patience_s=0.5, drops=True))
    sock.full = 3
    reports.send(FRAMES)
    assert len(sock.sent) == 3 and reports.refused == ()
    commands = link_of(sock, Options(patience_s=0.0, drops=True))
    sock.full = 1
    commands.send(FRAMES[:2])
    assert len(sock.sent) == 3, "nothing late"
    assert commands.refused == tuple(FRAMES[:2])
    commands.send(FRAMES[:1])
    assert commands.refused == (), "of the last send only"


# --- error frames, links that go -----------------------------------------------------------------------------------


def test_error_frames_are_named_by_class_and_controller_state(sock: FakeSocket) -> None:
    link = link_of(sock)
    sock.arrive(error_frame(0x04, 0x20), error_frame(0x04, 0x10 | 0x01), error_frame(0x80 | 0x20), FRAMES[0])
    sock.arrive(error_frame(0x100), error_frame(0))
    assert plain(link.receive(1.0)) == FRAMES[:1]
    assert dict(link.errors) == {
        "controller": 2,
        "tx_passive": 1,
        "rx_passive": 1,
        "rx_overflow": 1,
        "bus_error": 1,
        "no_ack": 1,
        "restarted": 1,
        "no_class": 1,
    }


def test_bus_off_is_an_error(sock: FakeSocket) -> None:
    link = link_of(sock)
    sock.arrive(error_frame(0x40))
    with pytest.raises(BenchError, match="can9 is bus-off") as caught:
        link.receive(1.0)
    assert caught.value.code == "bus_off" and link.errors["bus_off"] == 1


def test_remote_frames_are_not_handed_over(sock: FakeSocket) -> None:
    link = link_of(sock)
    sock.arrive(CLASSIC_FRAME.pack(0x60 | RTR_FLAG, 8, b""))
    assert link.receive(0.02) == []


@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.ENETDOWN, "can9 went down"), (errno.ENODEV, "can9 is gone"), (errno.ENXIO, "can9 is gone")],
)
def test_a_link_that_goes_is_named_at_once(sock: FakeSocket, number: int, words: str) -> None:
    link = link_of(sock)
    sock.fail(number)
    with pytest.raises(BenchError, match=words) as caught:
        link.receive(1.0)
    assert caught.value.code == "link_down" and "ip link set up can9" in caught.value.hint
    sock.send_error = number
    with pytest.raises(BenchError, match=words):
        link.send(FRAMES)


def test_an_fd_frame_on_a_classic_link_says_what_is_needed(sock: FakeSocket) -> None:
    sock.send_error = errno.EINVAL
    with pytest.raises(BenchError, match="CAN FD needs mtu 72"):
        link_of(sock).send(FRAMES[2:])


def test_a_listener_does_not_send(sock: FakeSocket) -> None:
    with pytest.raises(InputError, match="only listens"):
        link_of(sock, Options(may_send=False)).send(FRAMES)
    assert sock.sent == []


def test_a_node_whose_starter_is_gone_ends(sock: FakeSocket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LOOK_S", 0.0)
    alive = [True, False]
    link = link_of(sock, Options(alive=lambda: alive.pop(0)))
    assert link.receive(0.0) == []
    with pytest.raises(BenchError, match="the process that started this node is gone") as caught:
        link.receive(0.0)
    assert caught.value.code == "starter_gone"


# --- small things --------------------------------------------------------------------------------------------------


def test_filters_let_exactly_these_data_frames_through() -> None:
    ids = [0x60, 0x60 | EFF_FLAG]
    pairs = [FILTER.unpack_from(pack_filters(ids), at) for at in (0, FILTER.size)]

    def passes(can_id: int) -> bool:  # linux/can.h: how the kernel uses a filter
        return any(can_id & mask == wanted & mask for wanted, mask in pairs)

    assert passes(0x60) and passes(0x60 | EFF_FLAG)
    assert not passes(0x61) and not passes(0x60 | RTR_FLAG) and not passes(0x860 | EFF_FLAG)


def test_the_offset_between_the_clocks_does_not_jump() -> None:
    first = realtime_offset_ns()
    assert all(abs(realtime_offset_ns() - first) < 5_000_000 for _ in range(20))


def test_a_kernel_without_can_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    if hasattr(socket, "AF_CAN"):
        monkeypatch.setattr(module.can, "Bus", _no_bus)
    with pytest.raises(BenchError, match="socketcan:can9 does not open: no such address family"):
        module.open_socketcan("can9", "x")


def _no_bus(*words: object, **more: object) -> None:
    raise OSError("no such address family")
