"""The controller as a process of its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tunefree_hil.base.events import Event


def controller(bench: Path, *, bus: str, bench_bus: str, session: str, realtime: bool) -> Iterator[Event]:
    """Serve episodes on the bus until the runner says end or the bus is gone."""
    from tunefree_hil.bench import ControllerFor, load, needed_messages
    from tunefree_hil.jobs.node_links import open_exchange, timing_folder
    from tunefree_hil.nodes.controller import ControllerPart
    from tunefree_hil.nodes.node import Node
    from tunefree_hil.nodes.timing import CycleTimes

    parts = load(bench)
    with open_exchange(parts, "controller", bus, bench_bus, session, realtime=realtime) as (exchange, clock, where):
        yield Event("note", f"controller: {parts.vehicle.name} on {where}")
        times = CycleTimes(timing_folder())
        part = ControllerPart(parts.codec, needed_messages(parts.codec), ControllerFor(parts), times)
        Node(part, exchange, "lqr_pid_mrac", clock, realtime).serve()
    yield Event("result", "", {"sentence": "controller: told to end", "next": []})
