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
from tunefree_hil.bus.link import Links
from tunefree_hil.bus.open import BusChoice, open_links, require_virtual_link, resolve_bus
from tunefree_hil.jobs.processes import starter_is_gone
from tunefree_hil.nodes.exchange import Exchange

PATIENCE_S = 60.0  # a node may be started before its hub
TIMING_VARIABLE = "TUNEFREE_TIMING_DIR"  # where a node leaves its cycle times; set by whoever starts it
SWITCH_S = 0.0005


def timing_folder() -> Path | None:
    """Where cycle times go, or None."""
    text = os.environ.get(TIMING_VARIABLE, "")
    return Path(text) if text else None


def usable_bus(bus: str, session: str, bench_bus: str) -> BusChoice:
    """What --bus means for processes of their own. InputError where they could not meet, or must not transmit."""
    choice = resolve_bus(bus, session, bench_bus)
    if bus == "auto" and choice.kind == "socketcan":  # found up, but a drive could not be recorded from it
        why = f"tfhub, session {session}: vcan0 is up, but drives cannot be recorded from SocketCAN yet"
        choice = resolve_bus("tfhub", session, bench_bus)._replace(why=why)
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


def require_recorder(choice: BusChoice) -> None:
    """Raise InputError for a vehicle bus that nobody records: only the hub writes logs in this version."""
    if choice.kind != "tfhub":
        raise InputError(
            f"drives cannot be recorded from {choice.kind} yet",
            code="not_built",
            key="--bus",
            hint="use --bus tfhub; single nodes (ecu, controller) do open a vcan link",
        )


@contextmanager
def open_exchange(
    bench: Bench, name: str, bus: str, bench_bus: str, session: str, *, realtime: bool
) -> Iterator[tuple[Exchange, Clock, str]]:
    """(exchange, clock, where in words) for a node; leaves the bus in good order."""
    choice = usable_bus(bus, session, bench_bus)
    links = patiently(lambda: open_links(choice, name=name, stamps=not realtime), f"{name}: waiting for a hub")
    codec = bench.codec
    ids = (
        frozenset(message.key for message in codec.telemetry),
        frozenset(message.key for message in codec.commands),
    )
    sys.setswitchinterval(SWITCH_S)
    try:
        yield Exchange(links.vehicle, links.bench, ids, bench.dt_s, links.send_both), RealClock(), choice.why
    finally:
        links.close()


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
