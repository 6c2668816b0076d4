"""The hub as a process: routes the frames of one bench, orders them, writes its logs."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from tunefree_hil.base.events import Event


def hub(*, session: str, clock: str, transport: str, owned: bool) -> Iterator[Event]:
    """Serve until told to end, or until the owner is gone when `owned`.

    Of a bench in real time (clock = "real") it is as punctual as the nodes: frames that it hands on late are late.
    """
    from tunefree_hil.bus.tfhub.address import HubInfo
    from tunefree_hil.bus.tfhub.server.serve import say_on_stderr, serve
    from tunefree_hil.nodes.priority import punctual

    def announce(info: HubInfo) -> None:
        where = ", ".join(f"{channel} {address}" for channel, address in info.addresses.items())
        say_on_stderr(f"{info.session} runs, pid {info.pid}: {where}")

    with punctual() if clock == "real" else contextlib.nullcontext():
        why = serve(
            session,
            transport="tcp" if transport == "tcp" else "unix",
            clock="real" if clock == "real" else "sender",
            standalone=not owned,
            ready=announce,
        )
    yield Event("result", "", {"sentence": f"hub {session} ended: {why}", "next": []})
