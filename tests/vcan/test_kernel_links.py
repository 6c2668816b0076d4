"""Our SocketCAN link, the gate and doctor on links of a real kernel: losses by number, refusals by name."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator

import can
import pytest

from tests.vcan.peers import HERE, Links, ip
from tools.measures.faults import one_of_each_vehicle
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bench import load
from tunefree_hil.bus.open import LinkRequest, open_link, resolve_bus
from tunefree_hil.bus.socketcan.kernel_link import Claim, link_state
from tunefree_hil.bus.socketcan.link import SocketCanLink
from tunefree_hil.jobs.machine import NOTE, OK, check_bus, check_can_links
from tunefree_hil.jobs.running.node_links import resolve_process_bus, resolve_vehicle_bus, sends_fd

pytestmark = [pytest.mark.vcan, pytest.mark.timeout(300)]
BURST = 5000


def opened(link: str) -> SocketCanLink:
    found = open_link(f"socketcan:{link}", "vehicle", LinkRequest(name="a test", fd=True))
    assert isinstance(found, SocketCanLink)
    return found


@pytest.fixture
def pair(links: Links) -> Iterator[tuple[SocketCanLink, SocketCanLink]]:
    """Two members of one link."""
    both = opened(links.vehicle), opened(links.vehicle)
    yield both
    for one in both:
        one.close()


def numbered(count: int) -> list[CanFrame]:
    return [CanFrame(0x100, number.to_bytes(8, "little")) for number in range(count)]


def received(link: SocketCanLink, count: int) -> list[CanFrame]:
    found: list[CanFrame] = []
    while len(found) < count:
        frames = link.receive(20.0)
        assert frames, f"{len(found)} of {count} came"
        found += frames
    return found


# --- frames and losses -------------------------------------------------------------------------------------------


def test_a_burst_is_there_whole_and_in_order(pair: tuple[SocketCanLink, SocketCanLink]) -> None:
    """Our queue holds what a sleeping reader leaves: nothing is lost where python-can's own would lose."""
    sender, reader = pair
    sender.send(numbered(BURST))
    found = received(reader, BURST)
    assert [frame.data for frame in found] == [frame.data for frame in numbered(BURST)]
    stamps = [frame.time_s for frame in found]
    assert stamps == sorted(stamps) and reader.count_lost() == 0


def test_what_does_not_fit_is_named_with_the_exact_number(pair: tuple[SocketCanLink, SocketCanLink]) -> None:
    sender, reader = pair
    reader._sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 16_384)
    sender.send(numbered(BURST))
    kept = len(reader.receive_raw(1.0))
    lost = reader.count_lost()
    assert 0 < kept < BURST and kept + lost == BURST
    sender.send(numbered(1))  # it carries SO_RXQ_OVFL
    with pytest.raises(BenchError, match=rf"^{lost} frames of vcan0 did not fit") as caught:
        reader.receive(5.0)
    assert caught.value.code == "rx_overflow"
    sender.send(numbered(1))
    assert len(received(reader, 1)) == 1, "told once"


def test_fd_frames_and_29_bit_ids_cross_whole(pair: tuple[SocketCanLink, SocketCanLink]) -> None:
    sender, reader = pair
    frames = [CanFrame(0x18FEF100, bytes(8), True), CanFrame(0x7FF, bytes(range(64)), False, True)]
    sender.send(frames)
    assert [frame._replace(time_s=0.0) for frame in received(reader, 2)] == frames


def test_error_frames_are_counted_and_bus_off_is_an_error(
    pair: tuple[SocketCanLink, SocketCanLink], links: Links
) -> None:
    """vcan has no errors of its own, but hands on an error frame that a program makes (canerrsim does)."""
    reader = pair[1]
    with can.Bus(links.vehicle, interface="socketcan", ignore_config=True) as maker:
        maker.send(can.Message(arbitration_id=0x4, is_error_frame=True, data=[0, 0x20, 0, 0, 0, 0, 0, 0]))
        assert reader.receive(0.5) == []
        assert reader.errors == {"controller": 1, "tx_passive": 1}
        maker.send(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
        with pytest.raises(BenchError, match=f"{links.vehicle} is bus-off") as caught:
            reader.receive(5.0)
    assert caught.value.code == "bus_off"


def test_a_link_that_goes_down_is_named_at_once(
    pair: tuple[SocketCanLink, SocketCanLink], links: Links, mended: None
) -> None:
    sender, reader = pair
    down = threading.Timer(0.3, ip, ("link", "set", "down", links.vehicle))
    down.start()
    with pytest.raises(BenchError, match="went down") as caught:
        reader.receive(60.0)
    down.join()
    assert caught.value.code == "link_down" and f"ip link set up {links.vehicle}" in caught.value.hint
    with pytest.raises(BenchError, match="went down"):
        sender.send(numbered(1))


# --- what may be opened ------------------------------------------------------------------------------------------


def test_auto_takes_vcan0_and_only_for_one_bench(links: Links) -> None:
    assert resolve_process_bus("auto", "s", "").vehicle_address == f"socketcan:{links.vehicle}"
    code = f"from tunefree_hil.bus.socketcan.kernel_link import Claim; c = Claim({links.vehicle!r}); input('held')"
    words = [sys.executable, "-c", code]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None and other.stdout.read(4) == "held"
        choice = resolve_process_bus("auto", "s", "")
        assert choice.kind == "tfhub" and f"pid {other.pid}" in choice.why
        with pytest.raises(InputError, match=f"carries another bench of yours already, pid {other.pid}"):
            Claim(links.vehicle)
        other.communicate("\n")
    Claim(links.vehicle).close()


def test_a_link_that_is_not_there_or_down_is_refused_with_the_command(links: Links, mended: None) -> None:
    with pytest.raises(InputError, match="there is no network link vcan7") as caught:
        resolve_bus("socketcan:vcan7")
    assert "ip link add dev vcan7 type vcan" in caught.value.hint
    ip("link", "set", "down", links.vehicle)
    with pytest.raises(InputError, match=f"{links.vehicle} is down") as caught:
        resolve_bus(f"socketcan:{links.vehicle}")
    assert f"ip link set up {links.vehicle}" in caught.value.hint
    choice = resolve_bus("auto")
    assert choice.kind == "tfhub" and f"{links.vehicle} is down" in choice.why
    ip("link", "set", "up", links.vehicle)
    ip("link", "del", links.bench)
    with pytest.raises(InputError, match=f"there is no network link {links.bench}"):
        resolve_process_bus(f"socketcan:{links.vehicle}", "s", f"socketcan:{links.bench}")


def test_what_the_kernel_does_not_call_vcan_is_refused(links: Links) -> None:
    for name in ("lo", "vcan9"):
        if name == "vcan9":
            done = subprocess.run(["ip", "link", "add", "dev", name, "type", "vxcan"], capture_output=True)
            if done.returncode != 0:  # a kernel without that kind
                continue
            ip("link", "set", "up", name)
        try:
            with pytest.raises(InputError, match=f"{name} is not a vcan link") as caught:
                resolve_process_bus(f"socketcan:{name}", "s", "")
            assert caught.value.code == "no_gate"
        finally:
            if name == "vcan9":
                ip("link", "del", name)


def test_a_classic_link_is_refused_for_a_vehicle_with_fd_frames(links: Links, mended: None) -> None:
    ip("link", "set", "down", links.vehicle)
    ip("link", "set", links.vehicle, "mtu", "16")
    ip("link", "set", "up", links.vehicle)
    assert resolve_vehicle_bus(load(HERE / "bench.toml"), f"socketcan:{links.vehicle}", "s", "").kind == "socketcan"
    van = next(bench for bench in one_of_each_vehicle() if sends_fd(bench))
    with pytest.raises(InputError, match=rf"{links.vehicle} is a classic CAN link \(mtu 16\)") as caught:
        resolve_vehicle_bus(van, f"socketcan:{links.vehicle}", "s", "")
    for command in caught.value.hint.split(" && "):
        subprocess.run(command.removeprefix("sudo ").split(), check=True)
    assert resolve_vehicle_bus(van, f"socketcan:{links.vehicle}", "s", "").kind == "socketcan"


# --- doctor ------------------------------------------------------------------------------------------------------


def test_doctor_says_what_there_is(links: Links) -> None:
    found = list(check_can_links())
    assert [(one.kind, one.text.split(" (")[0]) for one in found] == [(OK, f"{name} is up") for name in links]
    assert all("vcan, mtu 72 (classic CAN and CAN FD)" in one.text for one in found)
    assert f"SocketCAN {links.vehicle}, because it is up" in check_bus("auto").text


def test_what_doctor_says_creates_the_links(links: Links, mended: None) -> None:
    """Its commands, word for word but for sudo and modprobe: an emulated machine has its modules loaded."""
    for name in links:
        ip("link", "del", name)
    missing = [one for one in check_can_links() if one.kind == NOTE]
    assert len(missing) == len(links)
    for one in missing:
        for command in one.remedy.split(" && "):
            words = command.removeprefix("sudo ").split()
            if words[0] != "modprobe":
                subprocess.run(words, check=True)
    for name in links:
        assert link_state(name)[:4] == (True, True, "vcan", 72)
    assert all(one.kind == OK for one in check_can_links())
