"""What the hub's tests share: a hub in a thread (quick) and peers in processes of their own (real)."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import can

from tools.measures._hub_process import HubProcess, start_hub
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.tfhub import address, records
from tunefree_hil.bus.tfhub.owner import Owner
from tunefree_hil.bus.tfhub.plugin import HubBus
from tunefree_hil.bus.tfhub.server.hub import HubOptions
from tunefree_hil.bus.tfhub.server.serve import serve

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 20.0  # a time-out that only a broken hub reaches
SO_RCVBUFFORCE = 33  # asm-generic/socket.h; beyond net.core.rmem_max, for root


class ThreadHub:
    """A hub in a thread of this process, with its owner."""

    def __init__(self, folder: Path, **options: Any) -> None:
        self.session = str(folder / "hub")
        self.said: list[str] = []
        self.why = ""
        self._error: BaseException | None = None
        ready = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(ready, options), daemon=True)
        self._thread.start()
        assert ready.wait(PATIENCE_S)
        if self._error:
            raise self._error
        self.info = address.read_hub(self.session)
        self.owner = Owner(self.session, name="owner")

    def _run(self, ready: threading.Event, options: dict[str, Any]) -> None:
        try:
            self.why = serve(self.session, HubOptions(**options), note=self.said.append, ready=lambda _: ready.set())
        except Exception as error:
            self._error = error
            ready.set()

    @property
    def vehicle(self) -> str:
        return address.endpoint(self.session, "vehicle")

    @property
    def bench(self) -> str:
        return address.endpoint(self.session, "bench")

    def member(self, name: str, channel: str = "vehicle", **options: Any) -> HubBus:
        return HubBus(address.endpoint(self.session, channel), role="member", name=name, **options)

    def observer(self, name: str, channel: str = "vehicle", **options: Any) -> HubBus:
        return HubBus(address.endpoint(self.session, channel), name=name, **options)

    def close(self) -> None:
        self.owner.close()
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive(), "the hub did not end with its owner"
        if self._error:
            raise self._error


@contextmanager
def thread_hub(folder: Path, **options: Any) -> Iterator[ThreadHub]:
    """A hub for the time of a `with`."""
    hub = ThreadHub(folder, **options)
    try:
        yield hub
    finally:
        hub.close()


@contextmanager
def child(code: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A Python process that runs `code`; killed at the end if it still runs. Its stdout is ours to read."""
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def frame(number: int, time_s: float = 0.0) -> CanFrame:
    """A frame that carries a number."""
    return CanFrame(0x100 + number % 0x400, number.to_bytes(8, "little"), False, False, time_s)


def number_of(data: bytes | bytearray) -> int:
    """The number that `frame` put in."""
    return int.from_bytes(data[:8], "little")


def eventually(true: Callable[[], object]) -> None:
    """Wait until something holds; an AssertionError when it never does."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < deadline_s, "it never came true"
        time.sleep(0.005)


def start_kind(kind: str, folder: Path) -> HubProcess:
    """A hub process for a row of the conformance suite, 'tfhub-unix' or 'tfhub-tcp'."""
    return start_hub(str(folder), transport="tcp" if kind == "tfhub-tcp" else "unix")


class Backend:
    """One kind of bus; `open` gives one more peer on its vehicle channel, closed after the test."""

    def __init__(self, kind: str, hub: HubProcess | None, stack: ExitStack) -> None:
        self.kind = kind
        self.hub = hub
        self.stack = stack
        self.channel = "vcan0" if kind == "socketcan" else f"test-{uuid.uuid4().hex}"

    def open(self, name: str = "", **options: Any) -> Any:
        if self.hub is not None:
            options = {"role": "member", "name": name, **options}
            bus = can.Bus(self.hub.vehicle, interface="tfhub", ignore_config=True, **options)
        else:
            more = {"fd": True} if self.kind == "socketcan" else {}
            bus = can.Bus(self.channel, interface=self.kind, ignore_config=True, **more, **options)
        bus = self.stack.enter_context(bus)
        if self.kind == "socketcan":  # the kernel's own 208 kB hold 277 frames, and what comes then is lost
            bus.socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 4 << 20)
        return bus


def receive_all(bus: can.BusABC, count: int) -> list[can.Message]:
    """`count` messages, or an AssertionError that says how many came."""
    found = []
    while len(found) < count:
        message = bus.recv(PATIENCE_S)
        assert message is not None, f"{len(found)} of {count} came"
        found.append(message)
    return found


def raw_connection(hub: ThreadHub, channel: str = "vehicle") -> socket.socket:
    """A socket that has not said hello."""
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    sock.settimeout(PATIENCE_S)
    sock.connect(hub.info.addresses[channel].removeprefix("unix:"))
    return sock


def hello(**changes: object) -> bytes:
    """A HELLO record, made by hand."""
    body = {"protocol": records.PROTOCOL, "role": "member", "name": "raw", "pid": 1, **changes}
    return records.pack_control(records.HELLO, body)


def last_word(sock: socket.socket) -> dict[str, str]:
    """The REFUSED record before the hub closed the connection."""
    data = b""
    while more := sock.recv(4096):
        data += more
    at = data.rindex(b"{")
    return json.loads(data[at:])
