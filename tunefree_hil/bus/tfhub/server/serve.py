"""Runs a hub in this process, for `python -m tunefree_hil.bus.tfhub` and the command `hub`."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Literal

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.tfhub.address import DEFAULT_TRANSPORT, HubInfo, Transport
from tunefree_hil.bus.tfhub.records import LOG_NAMES
from tunefree_hil.bus.tfhub.server.connections import OBSERVER_BYTES
from tunefree_hil.bus.tfhub.server.hub import Hub
from tunefree_hil.bus.tfhub.session import Session

HubClock = Literal["real", "sender"]


def say_on_stderr(line: str) -> None:
    """Print one line."""
    sys.stderr.write(f"tfhub: {line}\n")
    sys.stderr.flush()


def serve(
    session: str = "default",
    *,
    transport: Transport = DEFAULT_TRANSPORT,
    clock: HubClock = "real",
    standalone: bool = False,
    log_names: Mapping[str, str] = LOG_NAMES,
    observer_bytes: int = OBSERVER_BYTES,
    note: Callable[[str], None] = say_on_stderr,
    ready: Callable[[HubInfo], None] | None = None,
) -> str:
    """Route until the end; the reason of the end is returned.

    `session`: a name, or a directory of mode 0700. It ends when its owner goes (or never comes within 10 s), or, when
    `standalone`, at SIGINT or SIGTERM. With an owner SIGINT is left to the owner, which still wants its log.
    InputError when a hub runs there already or the directory is not private.
    """
    if transport not in ("unix", "tcp") or clock not in ("real", "sender"):
        raise InputError(f"no transport {transport!r} with clock {clock!r}", hint="unix or tcp; real or sender")
    for name in log_names.values():
        if not name.isalnum():  # cantools reads letters and digits only as a channel
            raise InputError(f"{name!r} cannot be a channel's name in a log", hint="letters and digits")
    claim = Session(session, transport, clock)
    hub = Hub(
        claim,
        standalone=standalone,
        log_names={**LOG_NAMES, **log_names},
        observer_bytes=observer_bytes,
        epoch_offset_ns=_epoch_offset_ns(),
        note=lambda line: note(f"{session}: {line}"),
    )
    before = _take_signals(hub, standalone)
    try:
        if ready is not None:
            ready(claim.info)
        hub.run()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return hub.ended


def _epoch_offset_ns() -> int:
    """Wall minus monotonic time, read once: stamps in logs are dates, but no step of the wall clock shows in them."""
    return round(datetime.now(UTC).timestamp() * 1e6) * 1000 - time.monotonic_ns()


def _take_signals(hub: Hub, standalone: bool) -> dict[int, Any]:
    """Let signals end the hub in good order; returns the handlers before."""
    if threading.current_thread() is not threading.main_thread():
        return {}

    def end(number: int, _frame: object) -> None:
        hub.stop(f"it was stopped by a signal ({signal.Signals(number).name})")

    wanted: dict[int, Any] = {signal.SIGTERM: end, signal.SIGINT: end if standalone else signal.SIG_IGN}
    return {number: signal.signal(number, handler) for number, handler in wanted.items()}
