"""One suite for every bus that this machine can open; a row that cannot run says why it is skipped.

The rows of a hub have it in a process of its own. What only our hub promises: test_tfhub_conformance.py.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack

import can
import pytest

from tests.bus.tfhub_help import PATIENCE_S, Backend, number_of, receive_all, start_kind
from tools.measures._hub_process import HubProcess
from tunefree_hil.bus.socketcan.kernel_link import kernel_has_can, link_state

BURST = 20_000
SO_RXQ_OVFL = 40  # asm-generic/socket.h


def _require(kind: str) -> None:
    if kind == "socketcan":
        if not kernel_has_can():
            pytest.skip("this kernel has no CAN")
        if link_state("vcan0").kind != "vcan" or not link_state("vcan0").up:
            pytest.skip("vcan0 is not up")


ALL = ["tfhub-unix", "tfhub-tcp", "virtual", pytest.param("socketcan", marks=pytest.mark.vcan)]
LOSSLESS = ["tfhub-unix", "tfhub-tcp", "virtual"]  # a kernel socket that nobody reads overflows: a row of its own


@pytest.fixture(scope="module")
def hubs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, HubProcess]]:
    """A hub of each transport that the tests share which leave it whole."""
    kinds = [kind for kind in ALL if isinstance(kind, str) and kind.startswith("tfhub")]
    with ExitStack() as stack:
        folder = tmp_path_factory.mktemp("hubs")
        yield {kind: stack.enter_context(start_kind(kind, folder / kind)) for kind in kinds}


@pytest.fixture(params=ALL)
def bus(request: pytest.FixtureRequest) -> Iterator[Backend]:
    _require(request.param)
    hubs = request.getfixturevalue("hubs") if request.param.startswith("tfhub") else {}  # else none is started
    with ExitStack() as stack:
        yield Backend(request.param, hubs.get(request.param), stack)


@pytest.fixture(params=LOSSLESS)
def lossless(request: pytest.FixtureRequest, hubs: dict[str, HubProcess]) -> Iterator[Backend]:
    with ExitStack() as stack:
        yield Backend(request.param, hubs.get(request.param), stack)


def test_frames_keep_their_order_and_all_their_flags(bus: Backend) -> None:
    a, b = bus.open("a"), bus.open("b")
    sent = [
        can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"\x01\x02\x03"),
        can.Message(arbitration_id=0x000, is_extended_id=False, data=b""),
        can.Message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=bytes(8)),
        can.Message(arbitration_id=0x123, is_extended_id=True, data=b"\xff" * 8),
        can.Message(arbitration_id=0x10, is_extended_id=False, is_remote_frame=True, dlc=5),
        can.Message(arbitration_id=0x11, is_extended_id=True, is_remote_frame=True, dlc=0),
        can.Message(arbitration_id=0x20, is_extended_id=False, is_fd=True, data=bytes(range(64)), bitrate_switch=True),
        can.Message(arbitration_id=0x21, is_extended_id=True, is_fd=True, data=bytes(12), error_state_indicator=True),
        can.Message(arbitration_id=0x22, is_extended_id=False, is_fd=True, data=b""),
        can.Message(arbitration_id=0x001, is_extended_id=False, data=b"\x01"),  # not sorted by id
    ]
    for message in sent:
        a.send(message)
    for wanted, found in zip(sent, receive_all(b, len(sent)), strict=True):
        assert found.equals(wanted, timestamp_delta=None, check_channel=False, check_direction=False), (wanted, found)
    assert b.recv(0.02) is None


def test_error_frames_stay_error_frames(bus: Backend) -> None:
    a, b = bus.open("a"), bus.open("b")
    a.send(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
    found = receive_all(b, 1)[0]
    assert found.is_error_frame and not found.is_remote_frame and found.arbitration_id == 0x40


def test_two_senders_are_seen_in_one_order(bus: Backend) -> None:
    senders = [bus.open(f"s{i}") for i in range(2)]
    readers = [bus.open(f"r{i}") for i in range(2)]
    threads = [threading.Thread(target=_send_numbers, args=(bus, sender, i)) for i, sender in enumerate(senders)]
    for thread in threads:
        thread.start()
    seen = [[(m.arbitration_id, number_of(m.data)) for m in receive_all(reader, 400)] for reader in readers]
    for thread in threads:
        thread.join()
    if bus.kind != "virtual":  # python-can's virtual bus delivers to one queue after the other, without a lock
        assert seen[0] == seen[1]
    for order in seen:
        for identifier in (0, 1):
            assert [number for found, number in order if found == identifier] == list(range(200))


def _send_numbers(bus: Backend, sender: can.BusABC, identifier: int) -> None:
    if bus.kind == "socketcan":  # vcan delivers by the processor that a frame was sent on: two hand out two orders
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # of this thread alone
    for number in range(200):
        sender.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=number.to_bytes(8, "little")))
        if bus.kind == "socketcan":
            time.sleep(0.0005)


def test_nobody_hears_himself_unless_he_wants_to(bus: Backend) -> None:
    a, b, echo = bus.open("a"), bus.open("b"), bus.open("echo", receive_own_messages=True)
    foreign = bus.kind != "socketcan"  # there is_rx means "from another computer", and on vcan nothing is
    a.send(can.Message(arbitration_id=1, is_extended_id=False))
    assert [(m.arbitration_id, m.is_rx) for m in receive_all(echo, 1)] == [(1, foreign)]
    echo.send(can.Message(arbitration_id=2, is_extended_id=False))
    assert [(m.arbitration_id, m.is_rx) for m in receive_all(echo, 1)] == [(2, False)]
    assert [(m.arbitration_id, m.is_rx) for m in receive_all(b, 2)] == [(1, foreign), (2, foreign)]
    assert [(m.arbitration_id, m.is_rx) for m in receive_all(a, 1)] == [(2, foreign)]
    assert a.recv(0.02) is None


def test_filters(bus: Backend) -> None:
    standard = {"can_id": 0x100, "can_mask": 0x7F0, "extended": False}
    extended = {"can_id": 0x5, "can_mask": 0x1FFFFFFF, "extended": True}
    a, b = bus.open("a"), bus.open("b", can_filters=[standard, extended])
    for identifier, long in [(0x100, False), (0x110, False), (0x10F, False), (0x5, True), (0x5, False), (0x6, True)]:
        a.send(can.Message(arbitration_id=identifier, is_extended_id=long))
    found = [(m.arbitration_id, m.is_extended_id) for m in receive_all(b, 3)]
    assert found == [(0x100, False), (0x10F, False), (0x5, True)]
    assert b.recv(0.02) is None
    b.set_filters(None)
    a.send(can.Message(arbitration_id=0x7, is_extended_id=False))
    assert receive_all(b, 1)[0].arbitration_id == 0x7


def test_a_time_out_is_none(bus: Backend) -> None:
    a = bus.open("a")
    start_s = time.monotonic()
    assert a.recv(0.0) is None and a.recv(0.05) is None
    assert time.monotonic() - start_s >= 0.045


def test_reconnect(bus: Backend) -> None:
    a = bus.open("a")
    for number in range(3):
        with bus.open("b") as b:
            a.send(can.Message(arbitration_id=number, is_extended_id=False))
            assert receive_all(b, 1)[0].arbitration_id == number
        b.shutdown()  # twice is fine
    assert a.recv(0.02) is None


def test_a_notifier_works(bus: Backend) -> None:
    a, b = bus.open("a"), bus.open("b")
    reader = can.BufferedReader()
    with can.Notifier(b, [reader], timeout=0.05):
        for number in range(50):
            a.send(can.Message(arbitration_id=number, is_extended_id=False))
        for number in range(50):
            message = reader.get_message(PATIENCE_S)
            assert message is not None and message.arbitration_id == number


@pytest.mark.slow
@pytest.mark.parametrize("fd", [False, True], ids=["classic", "fd"])
def test_nothing_is_lost_in_a_burst_with_a_sleeping_reader(lossless: Backend, fd: bool) -> None:
    """As fast as they go, the reader asleep for a second. With FD 3.7 MB: more than hub and kernel keep."""
    a, b = lossless.open("a"), lossless.open("b")
    count = 2 * BURST if fd else BURST
    filler = bytes(56) if fd else b""

    def send() -> None:
        for number in range(count):
            data = number.to_bytes(8, "little") + filler
            a.send(can.Message(arbitration_id=number % 0x7FF, is_extended_id=False, data=data, is_fd=fd))

    thread = threading.Thread(target=send)
    thread.start()
    time.sleep(1.0)
    if fd and lossless.hub is not None:
        assert thread.is_alive() and lossless.hub.owner.stats().held_by == ("b",), "there was no back-pressure"
    numbers = [number_of(message.data) for message in receive_all(b, count)]
    thread.join()
    assert numbers == list(range(count))
    assert b.recv(0.02) is None


@pytest.mark.vcan
@pytest.mark.parametrize("bus", ["socketcan"], indirect=True)
def test_a_burst_into_a_kernel_socket_loses_exactly_what_the_kernel_says(bus: Backend) -> None:
    """Nobody reads until all is sent. SO_RXQ_OVFL comes with each frame: how many were dropped before it."""
    sender = bus.open("a")
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as reader:
        reader.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        reader.bind((bus.channel,))
        for number in range(BURST):
            sender.send(can.Message(arbitration_id=1, is_extended_id=False, data=number.to_bytes(8, "little")))
        kept = [_kernel_frame(reader)[0] for _ in range(10)]  # room again
        sender.send(can.Message(arbitration_id=1, is_extended_id=False, data=BURST.to_bytes(8, "little")))
        lost = 0
        while kept[-1] != BURST:
            number, lost = _kernel_frame(reader)
            kept.append(number)
    assert kept == sorted(set(kept)) and 0 < lost < BURST
    assert len(kept) + lost == BURST + 1


def _kernel_frame(reader: socket.socket) -> tuple[int, int]:
    """(number in the frame, frames lost before it)."""
    reader.settimeout(PATIENCE_S)
    frame, extra, _, _ = reader.recvmsg(72, socket.CMSG_SPACE(4))
    dropped = [int.from_bytes(data, "little") for _, kind, data in extra if kind == SO_RXQ_OVFL]
    return number_of(frame[8:16]), dropped[0] if dropped else 0
