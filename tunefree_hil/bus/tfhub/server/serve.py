"""Runs a hub in this process, for `python -m tunefree_hil.bus.tfhub` and the command `hub`."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.tfhub.address import HubInfo
from tunefree_hil.bus.tfhub.server.hub import Hub, HubOptions
from tunefree_hil.bus.tfhub.session import Session


def say_on_stderr(line: str) -> None:
    """Print one line."""
    sys.stderr.write(f"tfhub: {line}\n")
    sys.stderr.flush()


def announce(info: HubInfo) -> None:
    """Print the hub's addresses."""
    where = ", ".join(f"{channel} {address}" for channel, address in info.addresses.items())
    say_on_stderr(f"{info.session} runs, pid {info.pid}: {where}")


def serve(
    session: str,
    options: HubOptions = HubOptions(),  # noqa: B008
    *,
    ready: Callable[[HubInfo], None] = announce,
    note: Callable[[str], None] = say_on_stderr,
) -> str:
    """Route until the end; the reason of the end is returned.

    `session`: a name, or a directory of mode 0700. It ends when its owner goes (or never comes within 10 s), or, when
    standalone, at SIGINT or SIGTERM. With an owner SIGINT is left to the owner, which still wants its log.
    InputError when a hub runs there already or the directory is not private.
    """
    transport, clock = options.transport, options.clock
    if transport not in ("unix", "tcp") or clock not in ("real", "sender"):
        raise InputError(f"no transport {transport!r} with clock {clock!r}", hint="unix or tcp; real or sender")
    for name in options.log_names.values():
        if not name.isalnum():  # cantools reads letters and digits only as a channel
            raise InputError(f"{name!r} cannot be a channel's name in a log", hint="letters and digits")
    claim = Session(session, transport, clock)
    hub = Hub(claim, options, _epoch_offset_ns(), lambda line: note(f"{session}: {line}"))
    before = _take_signals(hub, options.standalone)
    try:
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
