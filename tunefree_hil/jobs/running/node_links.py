"""How a node process gets on the bus: both links, the phases' ids, the clock."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tunefree_hil.base.clock import Clock, RealClock
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bench import Bench
from tunefree_hil.bus.bench_channel import Hello, Role, decode, hello_frames
from tunefree_hil.bus.link import Link, Links
from tunefree_hil.bus.open import (
    BusChoice,
    alone_on,
    open_link,
    open_links,
    require_fd_link,
    require_virtual_link,
    resolve_bus,
)
from tunefree_hil.bus.socketcan.link import Options
from tunefree_hil.jobs.running.processes import starter_is_gone
from tunefree_hil.nodes.exchange import HARD_LIMIT_S, Exchange

PATIENCE_S = 60.0  # a node may be started before its hub
TIMING_VARIABLE = "TUNEFREE_TIMING_DIR"  # where a node leaves its cycle times; set by whoever starts it
SWITCH_S = 0.0005
ONLY_ONE_S = 0.3  # an idle node answers in milliseconds


def timing_folder() -> Path | None:
    """Where cycle times go, or None."""
    text = os.environ.get(TIMING_VARIABLE, "")
    return Path(text) if text else None


def usable_bus(bus: str, session: str, bench_bus: str) -> BusChoice:
    """What --bus means for processes of their own. InputError where they could not meet, or must not transmit."""
    choice = resolve_bus(bus, session, bench_bus)
    for text in (choice.vehicle_address, choice.bench_address):
        kind, _, name = text.partition(":")
        if kind == "socketcan":
            require_virtual_link(name)
        if kind == "virtual":
            raise InputError(
                "python-can's virtual bus does not leave a process, and hub, ECU and controller have one each",
                code="one_process",
                key="--bus",
                hint="use --bus tfhub, which needs no kernel support either",
            )
    return choice


def bus_for(bench: Bench, bus: str, session: str, bench_bus: str) -> BusChoice:
    """`usable_bus`, and it carries this vehicle's frames. InputError for a classic link where the vehicle sends FD."""
    choice = usable_bus(bus, session, bench_bus)
    kind, _, name = choice.vehicle_address.partition(":")
    if kind == "socketcan" and sends_fd(bench):
        require_fd_link(name)
    return choice


def sends_fd(bench: Bench) -> bool:
    """Whether any frame of this vehicle is CAN FD."""
    return any(message.fd for message in (*bench.codec.telemetry, *bench.codec.commands))


def ids_of(bench: Bench) -> tuple[frozenset[int], frozenset[int]]:
    """(ids of the reports, ids of the commands), EFF bit included."""
    codec = bench.codec
    return frozenset(one.key for one in codec.telemetry), frozenset(one.key for one in codec.commands)


def send_patience_s(name: str, tick_s: float, realtime: bool) -> float:
    """How long a node asks a full transmit queue again: socketcan.py says why."""
    if not realtime:
        return HARD_LIMIT_S
    return 0.0 if name == "controller" else 0.5 * tick_s


def clock_of(realtime: bool) -> str:
    """The clock that a hub must have: in lockstep who sends a frame stamps it with virtual time."""
    return "real" if realtime else "sender"


@contextmanager
def open_exchange(
    bench: Bench, name: str, bus: str, bench_bus: str, session: str, *, realtime: bool, alone: bool = False
) -> Iterator[tuple[Exchange, Clock, str]]:
    """(exchange, clock, where in words) for a node; leaves the bus in good order.

    `alone`: without a bench channel where the vehicle's link is SocketCAN, so without a hub too.
    """
    choice = bus_for(bench, bus, session, bench_bus)
    ids = ids_of(bench)
    options = Options(
        patience_s=send_patience_s(name, bench.dt_s, realtime),
        drops=realtime,
        alive=lambda: not starter_is_gone(),
    )

    silent = alone and choice.kind == "socketcan"

    def open_both() -> Links:
        both = sorted(ids[0] | ids[1])
        if silent:
            return alone_on(open_link(choice, name=name, fd=sends_fd(bench), only=both, options=options))
        stamps, clock = not realtime, clock_of(realtime)
        return open_links(choice, name=name, stamps=stamps, fd=sends_fd(bench), only=both, clock=clock, options=options)

    links = patiently(open_both, f"{name}: waiting for a hub")
    sys.setswitchinterval(SWITCH_S)
    drops = realtime and choice.kind == "socketcan"
    exchange = Exchange(links.vehicle, links.bench, ids, bench.dt_s, links.send_both, drops=drops)
    try:
        if choice.bench_address.startswith("socketcan:") and not silent:
            require_only_one(links.bench, name)
        yield exchange, RealClock(), choice.why.partition(";")[0] if silent else choice.why
    finally:
        links.close()
        if exchange.refused:
            sys.stderr.write(f"{name}: {exchange.refused} frames were dropped: the transmit queue was full (ENOBUFS)\n")


def require_only_one(link: Link, name: str, wait_s: float = ONLY_ONE_S) -> None:
    """InputError where another node of this name answers on the bench channel; a hub knows that by itself."""
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
                    hint="end that one, or use another link for a bench of your own",
                )


def patiently(open_it: Callable[[], Links], words: str) -> Links:
    """Open the links, again and again while no hub is there yet; says so once after a second."""
    begun, said = time.monotonic(), False
    while True:
        try:
            return open_it()
        except InputError as error:
            if error.code == "duplicate_name":
                error.hint = "end that one, or use another --session for a bench of your own"
            raise
        except BenchError as error:
            waited_s = time.monotonic() - begun
            if error.code != "no_hub" or waited_s > PATIENCE_S or starter_is_gone():
                raise
            if waited_s > 1.0 and not said:
                said = True
                sys.stderr.write(f"{words} (start it with `tunefree-hil hub`)\n")
            time.sleep(0.02)
