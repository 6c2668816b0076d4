"""Main loop of a process in the controller's place: the built-in controller, or the planner of a collection."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load, needed_messages
from tunefree_hil.jobs.options.nodes import NodeLink
from tunefree_hil.jobs.running.node_links import open_exchange, timing_folder
from tunefree_hil.nodes.controller import Assignment, ControllerPart
from tunefree_hil.nodes.node import Announcement, Node
from tunefree_hil.nodes.timing import CycleTimes

OURS = "lqr_pid_mrac"  # name of the built-in controller on the bench channel
Assign = Callable[[bytes, Mapping[int, float]], Assignment]  # (hash of the scenario, parameters by index)


def serve_controller(
    bench: Path,
    link: NodeLink,
    command: str,
    assign_for: Callable[[Bench], Assign],
    announce_for: Callable[[Bench], Announcement],
) -> Iterator[Event]:
    """Serve episodes until the runner ends the node or the bus is lost.

    Args:
        command: Name of the command, for messages.
        assign_for: Makes the function that assigns a Block to each episode.
        announce_for: Makes what is announced on the bench channel.
    """
    parts = load(bench)
    with open_exchange(parts, "controller", link) as (exchange, clock, bus_text):
        yield Event("note", f"{command}: {parts.vehicle.name} on {bus_text}")
        times = CycleTimes(timing_folder())
        part = ControllerPart(parts.codec, needed_messages(parts.codec), assign_for(parts), times)
        Node(part, exchange, announce_for(parts), clock, link.realtime).serve()
    yield Event("result", "", {"sentence": f"{command}: ended by the runner", "next": []})
