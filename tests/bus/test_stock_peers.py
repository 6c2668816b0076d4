"""Tools that know nothing of us on our bus and on our logs: python-can's and cantools' own programs, as processes."""

from __future__ import annotations

import asyncio
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from tests.bus.tfhub_help import PATIENCE_S, eventually, frame, number_of, start_kind
from tools.measures._hub_process import HubProcess
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.tfhub.plugin import HubBus

DBC = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 291 Motion: 8 ECU
 SG_ Speed : 0|16@1+ (0.01,0) [0|655.35] "m/s" ECU
 SG_ Turned : 16|16@1- (0.1,0) [-3276.8|3276.7] "deg" ECU
BO_ 2566844416 Far: 8 ECU
 SG_ Count : 0|8@1+ (1,0) [0|255] "" ECU
"""
FRAMES = [
    CanFrame(291, (1234).to_bytes(2, "little") + (-57).to_bytes(2, "little", signed=True) + bytes(4)),
    CanFrame(2566844416 & 0x1FFFFFFF, bytes([42]) + bytes(7), True),
]

pytestmark = pytest.mark.slow


@pytest.fixture(params=["tfhub-unix", "tfhub-tcp"])
def hub(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[HubProcess]:
    with start_kind(request.param, tmp_path / "hub") as running:
        yield running


@pytest.fixture
def dbc(tmp_path: Path) -> Path:
    path = tmp_path / "test.dbc"
    path.write_text(DBC)
    return path


def script(name: str) -> str:
    """A program that was installed beside this Python."""
    path = Path(sys.executable).parent / name
    if not path.exists():
        pytest.skip(f"{name} is not installed beside {sys.executable}")
    return str(path)


@contextmanager
def running(command: list[str], **options: object) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(command, **options)  # type: ignore[call-overload]
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def has_peer(hub: HubProcess, role: str, word: str) -> bool:
    return any(peer.role == role and word in peer.name for peer in hub.owner.stats().peers)


def lines(path: Path) -> list[str]:
    """What a log says, without time and direction."""
    return [" ".join(line.split()[1:3]) for line in path.read_text().splitlines()]


def test_can_logger_writes_what_the_hub_writes(hub: HubProcess, tmp_path: Path) -> None:
    ours, theirs = tmp_path / "ours.log", tmp_path / "theirs.log"
    command = [sys.executable, "-m", "can.logger", "-i", "tfhub", "-c", hub.vehicle, "-f", str(theirs)]
    with running(command, stdout=subprocess.DEVNULL) as process, HubBus(f"{hub.vehicle}?role=member&name=a") as bus:
        eventually(lambda: has_peer(hub, "observer", "logger"))
        hub.owner.start_log({"vehicle": ours})
        bus.send_frames([frame(number) for number in range(500)] + FRAMES)
        bus.send_frames([CanFrame(9, bytes(range(24)), fd=True)])
        bus.send(can.Message(arbitration_id=9, is_extended_id=False, is_remote_frame=True))
        eventually(lambda: hub.owner.stats().frames["vehicle"] == 504)
        assert hub.owner.stop_log() == {"vehicle": 504}
        bus.send_frames([frame(number) for number in range(1000)])  # push the first ones out of its file's buffer
        eventually(lambda: theirs.exists() and len(lines(theirs)) > 504)
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
    assert lines(theirs)[:504] == lines(ours) and len(lines(ours)) == 504
    times = [[message.timestamp for message in can.LogReader(path)] for path in (ours, theirs)]
    offsets = [a - b for a, b in zip(*times, strict=False)]
    assert max(abs(offset) for offset in offsets) < 2e-6


def test_cantools_decodes_our_log(hub: HubProcess, tmp_path: Path, dbc: Path) -> None:
    path = tmp_path / "vehicle.log"
    hub.owner.start_log({"vehicle": path})
    with HubBus(f"{hub.vehicle}?role=member") as bus:
        bus.send_frames(FRAMES)
    eventually(lambda: hub.owner.stats().frames["vehicle"] == 2)
    hub.owner.stop_log()
    with path.open("rb") as log:
        done = subprocess.run([script("cantools"), "decode", str(dbc)], stdin=log, capture_output=True, timeout=60)
    text = done.stdout.decode()
    assert done.returncode == 0, done.stderr.decode()
    assert "Speed: 12.34 m/s" in text and "Turned: -5.7" in text and "Count: 42" in text
    assert text.count("can0") == 2


def test_cantools_monitor_shows_our_signals(hub: HubProcess, dbc: Path) -> None:
    pty = pytest.importorskip("pty")
    pytest.importorskip("curses")
    program = script("cantools")
    pid, screen = pty.fork()
    if pid == 0:
        os.environ.update(TERM="xterm", COLUMNS="100", LINES="30")
        os.execv(program, [program, "monitor", "-i", "tfhub", "-c", hub.vehicle, str(dbc)])
    try:
        with HubBus(f"{hub.vehicle}?role=member&name=a") as bus:
            text = ""
            deadline_s = time.monotonic() + PATIENCE_S
            while not re.search(r"Speed:\s+12\.34", text) and time.monotonic() < deadline_s:
                bus.send_frames(FRAMES)
                if select.select([screen], [], [], 0.1)[0]:
                    text += os.read(screen, 65536).decode(errors="replace")
        plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b\(B", "", text)
        assert re.search(r"Speed:\s+12\.34 m/s", plain), plain[-2000:]
        assert re.search(r"Count:\s+42", plain), plain[-2000:]
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(screen)


def test_can_player_plays_our_log_back(hub: HubProcess, tmp_path: Path) -> None:
    path, again = tmp_path / "vehicle.log", tmp_path / "again.log"
    sent = [frame(number) for number in range(300)] + FRAMES + [CanFrame(9, bytes(range(48)), fd=True)]
    hub.owner.start_log({"vehicle": path})
    with HubBus(f"{hub.vehicle}?role=member&name=a") as bus:
        bus.send_frames(sent)
        eventually(lambda: hub.owner.stats().frames["vehicle"] == len(sent))
        hub.owner.stop_log()
        hub.owner.start_log({"vehicle": again})
        where = f"{hub.vehicle}?role=member&name=player&listen=no"
        command = [sys.executable, "-m", "can.player", "-i", "tfhub", "-c", where, str(path)]
        done = subprocess.run(command, capture_output=True, timeout=60)
        assert done.returncode == 0, done.stderr.decode()
        found: list[CanFrame] = []
        while len(found) < len(sent):
            found += bus.recv_frames(PATIENCE_S)
        assert [got._replace(time_s=0.0) for got in found] == sent
        assert bus.recv(0.05) is None  # it said good-bye: no loss
    hub.owner.stop_log()
    assert lines(again) == lines(path)


def test_can_player_as_an_observer_is_refused_in_words(hub: HubProcess, tmp_path: Path) -> None:
    path = tmp_path / "one.log"
    path.write_text("(0.000000) can0 123#00\n")
    command = [sys.executable, "-m", "can.player", "-i", "tfhub", "-c", hub.vehicle, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode != 0 and "may not transmit" in done.stderr and "role=member" in done.stderr


def test_an_asyncio_notifier_gets_every_frame_at_once(hub: HubProcess) -> None:
    """python-can takes one frame for each time the socket is readable: none may wait inside the bus object."""

    async def listen() -> list[int]:
        reader = can.AsyncBufferedReader()
        with HubBus(hub.vehicle) as watcher, HubBus(f"{hub.vehicle}?role=member") as sender:
            notifier = can.Notifier(watcher, [reader], loop=asyncio.get_running_loop())
            sender.send_frames([frame(number)._replace(fd=number % 3 == 0) for number in range(300)])
            found = [await asyncio.wait_for(reader.get_message(), PATIENCE_S) for _ in range(300)]
            notifier.stop()
        return [number_of(message.data) for message in found]

    assert asyncio.run(listen()) == list(range(300))
