"""The controller as a separate process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tunefree_hil.base.events import Event


def controller(bench: Path, *, bus: str, bench_bus: str, session: str, realtime: bool) -> Iterator[Event]:
    """Serve episodes on the bus until the runner ends the node or the bus is lost."""
    from tunefree_hil.bench import ControllerFor, part_values
    from tunefree_hil.jobs.running.node_main import OURS, serve_controller

    yield from serve_controller(
        bench,
        ControllerFor,
        "controller",
        OURS,
        bus=bus,
        bench_bus=bench_bus,
        session=session,
        realtime=realtime,
        parameter_names=part_values,
    )
