"""The hub as a process: routes and orders the frames of one bench, and writes its logs."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from tunefree_hil.base.events import Event


def hub(*, session: str, clock: str, transport: str, owned: bool) -> Iterator[Event]:
    """Serve until ended by its owner, or until the owner is lost when `owned`.

    In real time (clock = "real") it gets the same scheduling priority as the nodes.
    """
    from tunefree_hil.bus.tfhub.server.hub import HubOptions
    from tunefree_hil.bus.tfhub.server.serve import serve
    from tunefree_hil.nodes.priority import punctual

    options = HubOptions(
        transport="tcp" if transport == "tcp" else "unix",
        clock="real" if clock == "real" else "sender",
        standalone=not owned,
    )
    with punctual() if clock == "real" else contextlib.nullcontext():
        why = serve(session, options)
    yield Event("result", "", {"sentence": f"hub {session} ended: {why}", "next": []})
