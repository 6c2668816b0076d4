"""The controller as a separate process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tunefree_hil.base.events import Event
from tunefree_hil.jobs.options.nodes import NodeLink


def controller(bench: Path, link: NodeLink) -> Iterator[Event]:
    """Serve episodes on the bus until the runner ends the node or the bus is lost."""
    from tunefree_hil.bench import ControllerFor, part_values
    from tunefree_hil.jobs.running.node_main import OURS, serve_controller
    from tunefree_hil.nodes.node import Announcement

    yield from serve_controller(
        bench,
        link,
        "controller",
        lambda parts: ControllerFor(parts, is_realtime=link.realtime),
        lambda parts: Announcement(OURS, list(part_values(parts))),
    )
