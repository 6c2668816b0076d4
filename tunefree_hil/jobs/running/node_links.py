"""Connect a node process to the bus: both links, the ids of the phases, the clock."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.clock import Clock, RealClock
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bench import Bench
from tunefree_hil.bus.bench_channel import Hello, Role, decode, hello_frames
from tunefree_hil.bus.link import BusLink, Links
from tunefree_hil.bus.open import (
    BusChoice,
    LinkRequest,
    alone_on,
    open_link,
    open_links,
    require_fd_link,
    require_virtual_link,
    resolve_bus,
)
from tunefree_hil.bus.socketcan.link import Options
from tunefree_hil.jobs.options.nodes import NodeLink
from tunefree_hil.jobs.running.processes import starter_is_gone
from tunefree_hil.nodes.exchange import HARD_LIMIT_S, Exchange

HUB_WAIT_S = 60.0  # a node may be started before its hub
TIMING_VARIABLE = "TUNEFREE_TIMING_DIR"  # folder for a node's cycle times, set by the process that starts it
THREAD_SWITCH_S = 0.0005
DUPLICATE_WAIT_S = 0.3  # an idle node answers in milliseconds


def timing_folder() -> Path | None:
    """Folder for cycle times, or None."""
    text = os.environ.get(TIMING_VARIABLE, "")
    return Path(text) if text else None


def resolve_process_bus(bus: str, session: str, bench_bus: str) -> BusChoice:
    """Resolve --bus for separate processes. Raises InputError where they could not connect, or must not transmit."""
    choice = resolve_bus(bus, session, bench_bus)
    for text in (choice.vehicle_address, choice.bench_address):
        kind, _, name = text.partition(":")
        if kind == "socketcan":
            require_virtual_link(name)
        if kind == "virtual":
            message = "python-can's virtual bus works inside one process only, and the nodes are separate processes"
            hint = "use --bus tfhub, which needs no kernel support either"
            raise InputError(message, code="one_process", key="--bus", hint=hint)
    return choice


def resolve_vehicle_bus(bench: Bench, bus: str, session: str, bench_bus: str) -> BusChoice:
    """As resolve_process_bus, for this vehicle. Raises InputError for a classic CAN link where it sends CAN FD."""
    choice = resolve_process_bus(bus, session, bench_bus)
    kind, _, name = choice.vehicle_address.partition(":")
    if kind == "socketcan" and sends_fd(bench):
        require_fd_link(name)
    return choice


def sends_fd(bench: Bench) -> bool:
    """Whether any frame of this vehicle is CAN FD."""
    return any(message.fd for message in (*bench.codec.telemetry, *bench.codec.commands))


def message_ids(bench: Bench) -> tuple[frozenset[int], frozenset[int]]:
    """Ids of the reports and of the commands, EFF bit included."""
    reports, commands = bench.codec.telemetry, bench.codec.commands
    return frozenset(message.key for message in reports), frozenset(message.key for message in commands)


def send_patience_s(name: str, tick_s: float, realtime: bool) -> float:
    """How long a node retries on a full transmit queue (bus/socketcan/link.py)."""
    if not realtime:
        return HARD_LIMIT_S
    return 0.0 if name == "controller" else 0.5 * tick_s


def hub_clock(realtime: bool) -> str:
    """Clock of the hub: in lockstep, the sender stamps its frames with virtual time."""
    return "real" if realtime else "sender"


class NodeConnection(NamedTuple):
    """A node's connection to the bus. bus_text: the bus in use, for messages."""

    exchange: Exchange
    clock: Clock
    bus_text: str


@contextmanager
def open_exchange(bench: Bench, name: str, link: NodeLink, *, alone: bool = False) -> Iterator[NodeConnection]:
    """Connect a node, and close its links at the end.

    alone: without bench channel and hub where the vehicle's link is SocketCAN.
    """
    choice, realtime = resolve_vehicle_bus(bench, link.bus, link.session, link.bench_bus), link.realtime
    ids = message_ids(bench)
    options = Options(
        patience_s=send_patience_s(name, bench.dt_s, realtime),
        drops=realtime,
        alive=lambda: not starter_is_gone(),
    )

    silent = alone and choice.kind == "socketcan"

    def open_both() -> Links:
        request = LinkRequest(name, fd=sends_fd(bench), only=sorted(ids[0] | ids[1]), options=options)
        if silent:
            return alone_on(open_link(choice, "vehicle", request))
        return open_links(choice, request._replace(stamps=not realtime, clock=hub_clock(realtime)))

    links = open_when_ready(open_both, f"{name}: waiting for a hub")
    sys.setswitchinterval(THREAD_SWITCH_S)
    drops = realtime and choice.kind == "socketcan"
    exchange = Exchange(links, ids, bench.dt_s, drops=drops)
    try:
        if choice.bench_address.startswith("socketcan:") and not silent:
            require_unique_node(links.bench, name)
        yield NodeConnection(exchange, RealClock(), choice.reason if silent else choice.why)
    finally:
        links.close()
        if exchange.refused:
            sys.stderr.write(f"{name}: {exchange.refused} frames were dropped: the transmit queue was full (ENOBUFS)\n")


def require_unique_node(link: BusLink, name: str, wait_s: float = DUPLICATE_WAIT_S) -> None:
    """Raise InputError where another node of this name answers on the bench channel; a hub checks that itself."""
    role = Role[name.upper()]
    for message in hello_frames(Role.RUNNER, f"{name} asks", []):
        link.send([message])
    deadline_s = time.monotonic() + wait_s
    while (rest_s := deadline_s - time.monotonic()) > 0.0:
        for frame in link.receive(rest_s):
            message = decode(frame)
            if isinstance(message, Hello) and message.role == role:
                raise InputError(
                    f"{name} is on the bus already: another one answers on this bench channel",
                    code="duplicate_name",
                    key="--bench-bus",
                    hint="end it, or use another link for this bench",
                )


def open_when_ready(open_links_once: Callable[[], Links], waiting_text: str) -> Links:
    """Open the links, and retry while there is no hub yet; reports the waiting once, after a second."""
    started, is_reported = time.monotonic(), False
    while True:
        try:
            return open_links_once()
        except InputError as error:
            if error.code == "duplicate_name":
                error.hint = "end the other one, or use another --session for this bench"
            raise
        except BenchError as error:
            waited_s = time.monotonic() - started
            if error.code != "no_hub" or waited_s > HUB_WAIT_S or starter_is_gone():
                raise
            if waited_s > 1.0 and not is_reported:
                is_reported = True
                sys.stderr.write(f"{waiting_text} (start it with `tunefree-hil hub`)\n")
            time.sleep(0.02)
