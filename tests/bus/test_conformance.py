"""One suite for every bus that this machine can open; a row that cannot run says why it is skipped.

The rows of a hub have it in a process of its own; peers that are killed are processes, too.
"""

from __future__ import annotations

import select
import sys
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import can
import pytest

from tests.bus.tfhub_help import PATIENCE_S, child, eventually, frame, number_of, receive_all
from tunefree_hil.base.errors import BenchError, InputError, PeerGone
from tunefree_hil.bus.kernel_link import kernel_has_can, link_state
from tunefree_hil.bus.tfhub import address
from tunefree_hil.bus.tfhub.owner import Owner
from tunefree_hil.bus.tfhub.plugin import HubBus, HubGone
from tunefree_hil.bus.tfhub.start import HubProcess, start_hub

BURST = 20_000


class Backend:
    """One kind of bus; `open` gives one more peer on its vehicle channel, closed after the test."""

    def __init__(self, kind: str, folder: Path, stack: ExitStack) -> None:
        self.kind = kind
        self.stack = stack
        self.hub: HubProcess | None = None
        self.channel = "vcan0" if kind == "socketcan" else f"test-{uuid.uuid4().hex}"
        if kind.startswith("tfhub"):
            self.hub = stack.enter_context(start_hub(str(folder / "hub"), transport=kind.removeprefix("tfhub-")))

    def open(self, name: str = "", **options: Any) -> Any:
        if self.hub is not None:
            options = {"role": "member", "name": name, **options}
            bus = can.Bus(self.hub.vehicle, interface="tfhub", ignore_config=True, **options)
        else:
            more = {"fd": True} if self.kind == "socketcan" else {}
            bus = can.Bus(self.channel, interface=self.kind, ignore_config=True, **more, **options)
        return self.stack.enter_context(bus)


def _require(kind: str) -> None:
    if kind == "tfhub-unix" and sys.platform == "win32":
        pytest.skip("no unix sockets on this system")
    if kind == "socketcan":
        if not kernel_has_can():
            pytest.skip("this kernel has no CAN")
        if link_state("vcan0").kind != "vcan" or not link_state("vcan0").up:
            pytest.skip("vcan0 is not up")


ALL = ["tfhub-unix", "tfhub-tcp", "virtual", pytest.param("socketcan", marks=pytest.mark.vcan)]
LOSSLESS = ["tfhub-unix", "tfhub-tcp", "virtual"]  # a kernel socket that nobody reads overflows, by design


def _backend(request: pytest.FixtureRequest, folder: Path) -> Iterator[Backend]:
    _require(request.param)
    with ExitStack() as stack:
        yield Backend(request.param, folder, stack)


@pytest.fixture(params=ALL)
def bus(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Backend]:
    yield from _backend(request, tmp_path)


@pytest.fixture(params=LOSSLESS)
def lossless(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Backend]:
    yield from _backend(request, tmp_path)


@pytest.fixture(params=["tfhub-unix", "tfhub-tcp"])
def tfhub(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Backend]:
    yield from _backend(request, tmp_path)


# --- every bus ---------------------------------------------------------------------------------------------------


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
    if bus.kind == "socketcan":
        pytest.skip("vcan does not carry error frames between sockets")
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
    for number in range(200):
        sender.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=number.to_bytes(8, "little")))
        if bus.kind == "socketcan":
            time.sleep(0.0005)


def test_nobody_hears_himself_unless_he_wants_to(bus: Backend) -> None:
    a, b, echo = bus.open("a"), bus.open("b"), bus.open("echo", receive_own_messages=True)
    a.send(can.Message(arbitration_id=1, is_extended_id=False))
    assert [(m.arbitration_id, m.is_rx) for m in receive_all(echo, 1)] == [(1, True)]
    echo.send(can.Message(arbitration_id=2, is_extended_id=False))
    assert [(m.arbitration_id, m.is_rx) for m in receive_all(echo, 1)] == [(2, False)]
    assert [(m.arbitration_id, m.is_rx) for m in receive_all(b, 2)] == [(1, True), (2, True)]
    assert [(m.arbitration_id, m.is_rx) for m in receive_all(a, 1)] == [(2, True)]
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
    """As fast as they go, the reader asleep for a second. With FD 3.7 MB: more than hub and kernel keep between them."""
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


# --- our hub -----------------------------------------------------------------------------------------------------


def test_two_full_sides_do_not_wait_for_each_other(tfhub: Backend) -> None:
    """Both send 2.7 MB before they read anything: a send that waits takes in what comes."""
    buses = [tfhub.open("a"), tfhub.open("b")]
    got: dict[str, list[int]] = {bus.name: [] for bus in buses}

    def send_then_read(bus: HubBus) -> None:
        for first in range(0, 30_000, 1000):
            bus.send_frames([frame(first + i)._replace(fd=True) for i in range(1000)], PATIENCE_S)
        while len(got[bus.name]) < 30_000:
            frames = bus.recv_frames(PATIENCE_S)
            assert frames
            got[bus.name] += [number_of(found.data) for found in frames]

    threads = [threading.Thread(target=send_then_read, args=(bus,)) for bus in buses]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert got == {"a": list(range(30_000)), "b": list(range(30_000))}


def test_a_stalled_observer_stalls_nobody(tfhub: Backend) -> None:
    assert tfhub.hub is not None
    a, b, stalled = tfhub.open("a"), tfhub.open("b"), tfhub.open("stalled", role="observer")
    count = 100_000
    sent = 0
    while sent < count:
        a.send_frames([frame(sent + i) for i in range(1000)], PATIENCE_S)
        sent += 1000
        got = 0
        while got < 1000:
            got += len(b.recv_frames(PATIENCE_S))
    dropped = tfhub.hub.owner.stats().dropped()["stalled"]
    assert 0 < dropped < count
    numbers: list[int] = []
    while not numbers or numbers[-1] < count - 1:
        numbers += [number_of(found.data) for found in stalled.recv_frames(PATIENCE_S)]
    assert numbers == sorted(set(numbers)) and len(numbers) + dropped == count
    assert stalled.dropped == dropped


WAIT = """
import sys, time
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus import HubBus
buses = [HubBus(text, role="member", name=sys.argv[1]) for text in sys.argv[2:]]
buses[0].send_frames([CanFrame(0x55, b"hello")])
time.sleep(60)
"""


@pytest.mark.slow
def test_a_killed_peer_is_named_once_and_the_bus_goes_on(tfhub: Backend) -> None:
    assert tfhub.hub is not None
    a, b = tfhub.open("a"), tfhub.open("b")
    for _ in range(2):
        with child(WAIT, "ecu", tfhub.hub.vehicle, tfhub.hub.bench) as process:
            for bus in (a, b):
                assert receive_all(bus, 1)[0].arbitration_id == 0x55
            process.kill()
            for bus in (a, b):
                with pytest.raises(PeerGone, match="ecu is gone from the bus") as raised:
                    bus.recv(PATIENCE_S)
                assert raised.value.peer == "ecu" and isinstance(raised.value, can.CanOperationError)
        a.send_frames([frame(1)])
        assert b.recv_frames(PATIENCE_S) and a.recv(0.02) is None
    assert tfhub.hub.said().count("lost member ecu") == 2


@pytest.mark.slow
def test_a_stopped_member_holds_the_bus_and_its_death_frees_it(tfhub: Backend) -> None:
    assert tfhub.hub is not None
    hub, a = tfhub.hub, tfhub.open("a")
    with child(WAIT, "sleeper", hub.vehicle) as process:
        assert receive_all(a, 1)
        with pytest.raises(can.CanTimeoutError, match="a member does not read"):
            for first in range(0, 200_000, 1000):
                a.send_frames([frame(first + i) for i in range(1000)], 0.3)
        assert hub.owner.stats().held_by == ("sleeper",)
        process.kill()
        with pytest.raises(PeerGone, match="sleeper"):
            a.recv(PATIENCE_S)
        b = tfhub.open("b")
        a.send_frames([frame(7)], PATIENCE_S)
        while number_of(b.recv_frames(PATIENCE_S)[-1].data) != 7:
            pass


@pytest.mark.slow
def test_a_killed_hub_is_named_by_everybody(tfhub: Backend) -> None:
    assert tfhub.hub is not None
    hub = tfhub.hub
    member, observer = tfhub.open("a"), tfhub.open("o", role="observer")
    member.send_frames([frame(1)])
    eventually(lambda: select.select([observer._connection.sock], [], [], 0.0)[0])
    hub.process.kill()
    hub.process.wait()
    assert observer.recv(PATIENCE_S) is not None  # what had come before
    for bus in (member, observer):
        for _ in range(2):
            with pytest.raises(HubGone, match=rf"hub .*pid {hub.process.pid}\) at (unix|tcp):.* is gone"):
                bus.recv(PATIENCE_S)
    with pytest.raises(HubGone):
        for _ in range(100):
            member.send(can.Message(arbitration_id=1))
    with pytest.raises(BenchError, match="is gone"):
        hub.owner.stats()
    with pytest.raises(BenchError):
        HubBus(hub.vehicle)
    with start_hub(hub.session) as again, HubBus(again.vehicle):  # what it left behind is no hindrance
        pass


@pytest.mark.parametrize("garbage", [b"\xff" * 1000, b"GET / HTTP/1.0\r\n\r\n", bytes(64)])
def test_garbage_costs_its_own_connection_only(tfhub: Backend, garbage: bytes) -> None:
    assert tfhub.hub is not None
    a, b, mad = tfhub.open("a"), tfhub.open("b"), tfhub.open("mad")
    mad._connection.sock.send(garbage)
    with pytest.raises(HubGone, match="dropped this connection"):
        mad.recv(PATIENCE_S)
    for bus in (a, b):
        with pytest.raises(PeerGone, match="mad is gone"):
            bus.recv(PATIENCE_S)
    a.send_frames([frame(1)])
    assert b.recv_frames(PATIENCE_S)
    assert "dropped mad" in tfhub.hub.said()


def test_one_name_once(tfhub: Backend) -> None:
    tfhub.open("twin")
    with pytest.raises(InputError, match="twin is on the bus already"):
        tfhub.open("twin")


def test_the_token(tmp_path: Path) -> None:
    with start_hub(str(tmp_path / "hub"), transport="tcp") as hub:
        info = address.read_hub(hub.session)
        wrong = tmp_path / "wrong"
        wrong.write_text("0" * 64)
        for text, token_file in ((info.addresses["vehicle"], ""), (info.addresses["vehicle"], str(wrong))):
            with pytest.raises(InputError, match="the token is wrong") as raised:
                HubBus(text, token_file=token_file)
            assert raised.value.code == "wrong_token"
        with pytest.raises(InputError, match="cannot be read"):
            HubBus(info.addresses["vehicle"], token_file=str(tmp_path / "none"))
        with HubBus(f"{info.addresses['vehicle']}?token_file={info.token_file}"):
            pass
        assert "refused" in hub.said() and hub.owner.stats().lost == ()
        with pytest.raises(InputError, match="has an owner already"):
            Owner(hub.session)


@pytest.mark.parametrize("text", ["tcp:0.0.0.0:4000", "tcp://192.168.1.1:4000", "tcp:example.org:4000"])
def test_nothing_but_loopback(text: str) -> None:
    with pytest.raises(InputError, match="not a loopback address"):
        HubBus(text)


def test_unknown_options_are_refused(tfhub: Backend) -> None:
    with pytest.raises(can.CanInitializationError, match="silent"):
        tfhub.open("a", silent=True)
    with pytest.raises(InputError, match="role"):
        tfhub.open("a", role="listener")
    quiet = tfhub.open("a", listen_only=True, bitrate=500_000, fd=True, data_bitrate=2_000_000)
    with pytest.raises(InputError, match="observer"):
        quiet.send(can.Message(arbitration_id=1))
