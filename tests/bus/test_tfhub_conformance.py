"""What only our hub promises, over both of its transports: back-pressure, named losses, refusals.

The hub is a process of its own, and so are peers that are killed.
"""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import can
import pytest

from tests.bus.tfhub_help import (
    PATIENCE_S,
    Backend,
    child,
    eventually,
    frame,
    hello,
    last_word,
    number_of,
    receive_all,
    start_kind,
)
from tools.measures._hub_process import HubProcess, start_hub
from tunefree_hil.base.errors import BenchError, InputError, PeerGone
from tunefree_hil.bus.tfhub import address
from tunefree_hil.bus.tfhub.owner import Owner
from tunefree_hil.bus.tfhub.plugin import HubBus, HubGone

KINDS = ["tfhub-unix", "tfhub-tcp"]
ROWS = [*KINDS, pytest.param("socketcan", marks=pytest.mark.vcan)]
NO_PEERS = "a kernel bus has neither members nor observers: nobody is named who goes or stalls, nobody is refused"


@pytest.fixture(scope="module")
def hubs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, HubProcess]]:
    """A hub of each transport that the tests share which leave it whole."""
    with ExitStack() as stack:
        folder = tmp_path_factory.mktemp("hubs")
        yield {kind: stack.enter_context(start_kind(kind, folder / kind)) for kind in KINDS}


@pytest.fixture(params=ROWS)
def tfhub(request: pytest.FixtureRequest) -> Iterator[Backend]:
    if request.param not in KINDS:
        pytest.skip(NO_PEERS)
    hubs: dict[str, HubProcess] = request.getfixturevalue("hubs")
    with ExitStack() as stack:
        yield Backend(request.param, hubs[request.param], stack)


@pytest.fixture(params=ROWS)
def own_hub(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Backend]:
    """A hub of the test's own, to be maltreated."""
    if request.param not in KINDS:
        pytest.skip(NO_PEERS)
    with start_kind(request.param, tmp_path / "hub") as hub, ExitStack() as stack:
        yield Backend(request.param, hub, stack)


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
    dropped = next(peer.dropped for peer in tfhub.hub.owner.stats().peers if peer.name == "stalled")
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
def test_a_killed_peer_is_named_once_and_the_bus_goes_on(own_hub: Backend) -> None:
    assert own_hub.hub is not None
    a, b = own_hub.open("a"), own_hub.open("b")
    for _ in range(2):
        with child(WAIT, "ecu", own_hub.hub.vehicle, own_hub.hub.bench) as process:
            for bus in (a, b):
                assert receive_all(bus, 1)[0].arbitration_id == 0x55
            process.kill()
            for bus in (a, b):
                with pytest.raises(PeerGone, match="ecu is gone from the bus") as raised:
                    bus.recv(PATIENCE_S)
                assert raised.value.peer == "ecu" and isinstance(raised.value, can.CanOperationError)
        a.send_frames([frame(1)])
        assert b.recv_frames(PATIENCE_S) and a.recv(0.02) is None
    assert own_hub.hub.messages().count("lost member ecu") == 2


@pytest.mark.slow
def test_a_stopped_member_holds_the_bus_and_its_death_frees_it(own_hub: Backend) -> None:
    assert own_hub.hub is not None
    hub, a = own_hub.hub, own_hub.open("a")
    with child(WAIT, "sleeper", hub.vehicle) as process:
        assert receive_all(a, 1)
        with pytest.raises(can.CanTimeoutError, match="a member does not read"):
            for first in range(0, 200_000, 1000):
                a.send_frames([frame(first + i) for i in range(1000)], 0.3)
        assert hub.owner.stats().held_by == ("sleeper",)
        process.kill()
        with pytest.raises(PeerGone, match="sleeper"):
            a.recv(PATIENCE_S)
        b = own_hub.open("b")
        a.send_frames([frame(7)], PATIENCE_S)
        while number_of(b.recv_frames(PATIENCE_S)[-1].data) != 7:
            pass


@pytest.mark.slow
def test_a_killed_hub_is_named_by_everybody(own_hub: Backend) -> None:
    assert own_hub.hub is not None
    hub = own_hub.hub
    member, observer = own_hub.open("a"), own_hub.open("o", role="observer")
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
    assert "dropped mad" in tfhub.hub.messages()


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
        odd = address.parse(info.addresses["vehicle"])
        for token in (3, "\ud800", None, "x" * 5000):  # no such thing may hurt the hub
            with socket.create_connection((odd.host, odd.port)) as sock:
                sock.sendall(hello(token=token))
                assert "the token is wrong" in last_word(sock)["message"]
        with pytest.raises(InputError, match="cannot be read"):
            HubBus(info.addresses["vehicle"], token_file=str(tmp_path / "none"))
        with HubBus(f"{info.addresses['vehicle']}?token_file={info.token_file}"):
            pass
        assert "refused" in hub.messages() and hub.owner.stats().lost == ()
        with pytest.raises(InputError, match="has an owner already"):
            Owner(hub.session)


@pytest.mark.parametrize("text", ["tcp:0.0.0.0:4000", "tcp://192.168.1.1:4000", "tcp:example.org:4000"])
def test_nothing_but_loopback(text: str) -> None:
    with pytest.raises(InputError, match="not a loopback address"):
        HubBus(text)


def test_what_other_adapters_need_is_no_hindrance(tfhub: Backend) -> None:
    with pytest.raises(InputError, match="role"):
        tfhub.open("a", role="listener")
    tfhub.open("a", bitrate=500_000, fd=True, data_bitrate=2_000_000, single_handle=True, app_name="x").send_frames([])


@pytest.mark.parametrize("how", [{"listen_only": True}, {"state": can.BusState.PASSIVE}])
def test_listen_only_is_never_swallowed(tfhub: Backend, how: dict[str, object]) -> None:
    quiet = tfhub.open("a", **how)
    with pytest.raises(InputError, match="observer"):
        quiet.send(can.Message(arbitration_id=1))
