"""The simulated by-wire vehicle as a process of its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tunefree_hil.base.events import Event


def ecu(bench: Path, *, model: str | None, bus: str, bench_bus: str, session: str, realtime: bool) -> Iterator[Event]:
    """Serve episodes on the bus until the runner says end or the bus is gone."""
    from tunefree_hil.bench import VehicleFor, load
    from tunefree_hil.jobs.node_links import open_exchange, timing_folder
    from tunefree_hil.nodes.ecu import EcuPart
    from tunefree_hil.nodes.node import Node
    from tunefree_hil.nodes.timing import CycleTimes

    parts = load(bench)
    assign = VehicleFor(parts, model or parts.spec.model, realtime=realtime)
    with open_exchange(parts, "ecu", bus, bench_bus, session, realtime=realtime) as (exchange, clock, where):
        yield Event("note", f"ecu: {parts.vehicle.name} ({assign.model_name}) on {where}")
        part = EcuPart(parts.codec, assign, CycleTimes(timing_folder()))
        Node(part, exchange, assign.model_name, clock, realtime).serve()
    yield Event("result", "", {"sentence": "ecu: told to end", "next": []})
