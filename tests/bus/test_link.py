"""Links over every kind of bus, `--bus` texts, and where transmitting is refused."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import can
import pytest

from tests.bus.tfhub_help import PATIENCE_S, ROOT, ThreadHub, frame, number_of, thread_hub
from tunefree_hil.base.errors import BenchError, InputError, NoAnswer, PeerGone
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus import link
from tunefree_hil.bus import open as bus_open
from tunefree_hil.bus.open import BusChoice, LinkRequest, open_link, require_virtual_link, resolve_bus
from tunefree_hil.bus.socketcan import kernel_link
from tunefree_hil.bus.socketcan.kernel_link import KernelLinkState, kernel_has_can, link_state

DATA = [
    CanFrame(0x123, b"\x01\x02", time_s=0.01),
    CanFrame(0x18FEF100, bytes(8), True, time_s=0.02),
    CanFrame(0x7FF, bytes(range(64)), False, True, 0.03),
    CanFrame(0x18FEF100, bytes(12), True, True, 0.04),
]


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[ThreadHub]:
    with thread_hub(tmp_path, clock="sender") as running:
        yield running


@pytest.fixture
def no_can(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus_open, "kernel_has_can", lambda: False)


def fake_links(monkeypatch: pytest.MonkeyPatch, **states: KernelLinkState) -> None:
    monkeypatch.setattr(bus_open, "kernel_has_can", lambda: True)
    monkeypatch.setattr(bus_open, "link_state", lambda name: states.get(name, KernelLinkState(False, False, "")))


def pair(hub: ThreadHub, kind: str) -> tuple[link.Link, link.Link]:
    choice = resolve_bus("tfhub" if kind == "tfhub" else f"virtual:{uuid.uuid4().hex}", hub.session)
    a = open_link(choice, "vehicle", LinkRequest(name="a", stamps=True, fd=True))
    return a, open_link(choice, "vehicle", LinkRequest(name="b", stamps=True, fd=True))


@pytest.mark.parametrize("kind", ["tfhub", "virtual"])
def test_frames_cross_a_link_whole(hub: ThreadHub, kind: str) -> None:
    a, b = pair(hub, kind)
    with closing(a), closing(b):
        assert (a.name, b.name) == ("a", "b")
        a.send(DATA)
        a.send([])
        found: list[CanFrame] = []
        while len(found) < len(DATA):
            found += b.receive(PATIENCE_S)
        assert found == DATA
        assert b.receive(0.0) == [] and a.receive(0.01) == []


@pytest.mark.parametrize("kind", ["tfhub", "virtual"])
def test_what_is_no_data_is_never_handed_over(hub: ThreadHub, kind: str) -> None:
    a, b = pair(hub, kind)
    with closing(a), closing(b):
        raw = a._bus  # type: ignore[attr-defined]
        raw.send(can.Message(arbitration_id=5, is_extended_id=False, is_remote_frame=True, dlc=8))
        raw.send(can.Message(arbitration_id=0x20 | 0x04, is_error_frame=True, data=bytes(8)))
        raw.send(can.Message(arbitration_id=0, is_error_frame=True))
        a.send([frame(1)])
        found: list[CanFrame] = []
        while not found:
            found = b.receive(PATIENCE_S)
        assert [number_of(got.data) for got in found] == [1]
        raw.send(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
        with pytest.raises(BenchError, match="is bus-off") as raised:
            b.receive(PATIENCE_S)
        assert raised.value.code == "bus_off"


def test_a_lost_peer_and_a_lost_hub(tmp_path: Path) -> None:
    hub = ThreadHub(tmp_path)
    a, b = pair(hub, "tfhub")
    a._bus._connection.sock.close()  # type: ignore[attr-defined]
    with pytest.raises(PeerGone) as raised:
        b.receive(PATIENCE_S)
    assert raised.value.peer == "a" and b.receive(0.01) == []
    hub.close()
    with pytest.raises(BenchError, match="is gone"):
        b.receive(PATIENCE_S)
    with pytest.raises(BenchError, match="is gone"):
        b.send([frame(1)])
    a.close()
    b.close()


def test_a_bus_that_is_held_is_said(hub: ThreadHub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "SEND_S", 0.1)
    a, b = pair(hub, "tfhub")
    with pytest.raises(NoAnswer, match="a member does not read"):
        for _ in range(200):
            a.send([frame(number) for number in range(1000)])
    b.close()
    a.close()


def test_an_observer_link(hub: ThreadHub) -> None:
    choice = resolve_bus("tfhub", hub.session)
    with closing(open_link(choice, "bench", LinkRequest(name="watcher", role="observer"))) as watcher:
        with closing(open_link(choice.bench_address, "bench", LinkRequest(name="talker"))) as talker:
            talker.send([frame(1)])
            assert watcher.receive(PATIENCE_S)
        with pytest.raises(InputError, match="may not transmit"):
            watcher.send([frame(1)])
    quiet = open_link(f"virtual:{uuid.uuid4().hex}", "vehicle", LinkRequest(role="observer", name="quiet"))
    with closing(quiet), pytest.raises(InputError, match="quiet only listens"):
        quiet.send([frame(1)])


def test_stamps_of_a_foreign_bus_are_monotonic() -> None:
    address = f"virtual:{uuid.uuid4().hex}"
    with closing(open_link(address)) as a, closing(open_link(address)) as b:
        before_s = time.monotonic()
        a.send([CanFrame(1, b"")])
        stamp_s = b.receive(PATIENCE_S)[0].time_s
        assert before_s - 0.01 < stamp_s < time.monotonic() + 0.01


def test_a_bus_of_a_session_name(hub: ThreadHub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text in (hub.session, f"{hub.session}/veh", f"{hub.session}/bench", hub.info.addresses["vehicle"]):
        choice = resolve_bus(f"tfhub:{text}", "another")
        assert choice.vehicle_address == f"tfhub:{hub.vehicle}" and choice.bench_address == f"tfhub:{hub.bench}"
    for text in (f"tfhub:{hub.session}", f"tfhub:{hub.info.addresses['bench']}", f"tfhub:{hub.bench}?name=x"):
        with closing(open_link(text, "bench", LinkRequest(role="observer"))) as opened:
            assert opened._bus.welcome.channel == "bench"  # type: ignore[attr-defined]


def test_a_bus_by_port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(BenchError, match="no hub of yours listens"):
        resolve_bus("tfhub:tcp:127.0.0.1:1")
    with pytest.raises(InputError, match="not a loopback"):
        resolve_bus("tfhub:tcp:10.0.0.1:4000")


# --- --bus -------------------------------------------------------------------------------------------------------


def test_auto(monkeypatch: pytest.MonkeyPatch) -> None:
    good = KernelLinkState(True, True, "vcan")
    fake_links(monkeypatch, vcan0=good)
    choice = resolve_bus("auto", "s")
    assert choice.kind == "socketcan" and choice.vehicle_address == "socketcan:vcan0"
    assert choice.bench_address.startswith("tfhub:") and "because it is up" in choice.why
    for state, word in [
        (KernelLinkState(False, False, ""), "there is no vcan0"),
        (KernelLinkState(True, False, "vcan"), "vcan0 is down"),
        (KernelLinkState(True, True, "veth"), "not a vcan link"),
        (KernelLinkState(True, True, ""), "not a vcan link"),
    ]:
        fake_links(monkeypatch, vcan0=state)
        choice = resolve_bus("auto", "s")
        assert choice.kind == "tfhub" and word in choice.why and "\n" not in choice.why
    monkeypatch.setattr(bus_open, "kernel_has_can", lambda: False)
    assert "this kernel has no CAN" in resolve_bus().why


def test_no_can_in_the_kernel_is_said_with_what_to_do(no_can: None) -> None:
    for call in (lambda: resolve_bus("socketcan:vcan0"), lambda: open_link("socketcan:vcan0")):
        with pytest.raises(InputError, match="this kernel has no CAN") as raised:
            call()
        assert "ip link add dev vcan0 type vcan" in raised.value.hint and "--bus tfhub" in raised.value.hint


def test_only_what_the_kernel_calls_vcan_may_be_sent_on(monkeypatch: pytest.MonkeyPatch) -> None:
    states = {
        "vcan0": KernelLinkState(True, True, "veth"),
        "can0": KernelLinkState(True, True, ""),
        "off": KernelLinkState(True, False, "vcan"),
    }
    fake_links(monkeypatch, **states)
    for name in ("vcan0", "can0"):
        with pytest.raises(InputError, match="needs the safety gate") as raised:
            open_link(f"socketcan:{name}")
        assert raised.value.code == "no_gate"
        with pytest.raises(InputError, match="needs the safety gate"):
            resolve_bus("tfhub", "s", f"socketcan:{name}")
    with pytest.raises(InputError, match="off is down"):
        open_link("socketcan:off")
    with pytest.raises(InputError, match="no network link none0"):
        resolve_bus("socketcan:none0")


@pytest.mark.parametrize("text", ["slcan:/dev/ttyACM0", "pcan:PCAN_USBBUS1", "kvaser:0", "udp_multicast:ff15::1"])
def test_real_adapters_wait_for_the_gate(text: str) -> None:
    for call in (
        lambda: resolve_bus(text),
        lambda: open_link(text),
        lambda: open_link(text, "vehicle", LinkRequest(role="observer")),
    ):
        with pytest.raises(InputError, match="safety gate") as raised:
            call()
        assert raised.value.code == "no_gate"


@pytest.mark.parametrize("text", ["", "nothing", "socketcan", "socketcan:", "auto:x"])
def test_no_bus(text: str) -> None:
    with pytest.raises(InputError, match="no bus"):
        resolve_bus(text)


def test_the_bench_channel(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_links(monkeypatch, vcan1=KernelLinkState(True, True, "vcan"))
    choice = resolve_bus("virtual", "s", "socketcan:vcan1")
    assert choice == BusChoice("virtual", "virtual:s-vehicle", "socketcan:vcan1", choice.reason, "socketcan:vcan1")
    with pytest.raises(InputError, match="no channel"):
        open_link(choice, "body")


# --- the kernel --------------------------------------------------------------------------------------------------


def test_the_loopback_link_is_there_and_is_no_vcan() -> None:
    if not hasattr(kernel_link.socket, "AF_NETLINK"):
        pytest.skip("no rtnetlink on this system")
    assert link_state("lo").exists and link_state("lo").kind == ""
    for name in ("", "nosuchlink", "x" * 40, "../lo"):
        assert link_state(name) == KernelLinkState(False, False, "")
    with pytest.raises(InputError, match="lo is not a vcan link but hardware"):
        require_virtual_link("lo")
    with pytest.raises(InputError, match="not there"):
        require_virtual_link("nosuchlink")


PRETENDER = """
import sys
from tunefree_hil.bus.socketcan.kernel_link import link_state
from tunefree_hil.bus.open import require_virtual_link
print(link_state("vcan0"))
try:
    require_virtual_link("vcan0")
except Exception as error:
    print(type(error).__name__, error)
"""


@pytest.mark.slow
def test_a_link_that_is_only_named_vcan0_does_not_pass() -> None:
    """In a network namespace of its own: a pair of Ethernet links, one of them called vcan0, and up."""
    if not shutil.which("unshare") or not shutil.which("ip"):
        pytest.skip("no unshare or ip")
    make = 'ip link add vcan0 type veth peer name other && ip link set vcan0 up && exec "$@"'
    command = ["unshare", "--net", "sh", "-c", make, "sh", sys.executable, "-c", PRETENDER]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    if "kind=" not in done.stdout:
        pytest.skip(f"no network namespace with a veth pair here: {done.stderr.strip()}")
    assert "KernelLinkState(exists=True, up=True, kind='veth', mtu=1500" in done.stdout
    assert "InputError" in done.stdout and "vcan0 is not a vcan link but of kind veth" in done.stdout


@pytest.mark.vcan
def test_vcan() -> None:
    if not kernel_has_can() or link_state("vcan0")[:3] != (True, True, "vcan"):
        pytest.skip("no vcan0 that is up")
    require_virtual_link("vcan0")
    assert resolve_bus().kind == "socketcan"
    with (
        closing(open_link("socketcan:vcan0", "vehicle", LinkRequest(fd=True))) as a,
        closing(open_link("socketcan:vcan0", "vehicle", LinkRequest(fd=True))) as b,
    ):
        before_s = time.monotonic()
        a.send(DATA)
        found: list[CanFrame] = []
        while len(found) < len(DATA):
            found += b.receive(PATIENCE_S)
        assert [got._replace(time_s=0.0) for got in found] == [sent._replace(time_s=0.0) for sent in DATA]
        assert all(before_s - 0.01 < got.time_s < time.monotonic() + 0.01 for got in found)
