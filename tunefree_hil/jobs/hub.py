"""The hub as a process: routes and orders the frames of one bench, and writes its logs."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from tunefree_hil.base.events import Event
from tunefree_hil.jobs.options.nodes import HubProcessOptions


def hub(options: HubProcessOptions) -> Iterator[Event]:
    """Serve until ended by its owner, or until the owner is lost when `options.owned`.

    In real time (`options.clock` = "real") it gets the same scheduling priority as the nodes.
    """
    from tunefree_hil.bus.tfhub.server.hub import HubOptions
    from tunefree_hil.bus.tfhub.server.serve import serve
    from tunefree_hil.nodes.priority import punctual

    served = HubOptions(transport=options.transport, clock=options.clock, standalone=not options.owned)
    with punctual() if options.clock == "real" else contextlib.nullcontext():
        why = serve(options.session, served)
    yield Event("result", "", {"sentence": f"hub {options.session} ended: {why}", "next": []})
