"""Main loop of a process in the controller's place: the built-in controller, or the planner of a collection."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load, needed_messages
from tunefree_hil.jobs.running.node_links import open_exchange, timing_folder
from tunefree_hil.nodes.controller import Assignment, ControllerPart
from tunefree_hil.nodes.node import Node
from tunefree_hil.nodes.timing import CycleTimes

OURS = "lqr_pid_mrac"  # name of the built-in controller on the bench channel
Assign = Callable[[bytes, Mapping[int, float]], Assignment]  # (hash of the scenario, parameters by index)


def serve_controller(
    bench: Path,
    assign_for: Callable[[Bench], Assign],
    command: str,
    name: str,
    *,
    bus: str,
    bench_bus: str,
    session: str,
    realtime: bool,
    parameter_names: Callable[[Bench], Iterable[str]] = lambda bench: (),
) -> Iterator[Event]:
    """Serve episodes until the runner ends the node or the bus is lost.

    Args:
        assign_for: Makes the function that assigns a Block to each episode.
        command: Name of the command, for messages.
        name: Name announced on the bench channel.
        parameter_names: Additional parameters announced there.
    """
    parts = load(bench)
    with open_exchange(parts, "controller", bus, bench_bus, session, realtime=realtime) as (exchange, clock, bus_text):
        yield Event("note", f"{command}: {parts.vehicle.name} on {bus_text}")
        times = CycleTimes(timing_folder())
        assign, names = assign_for(parts), list(parameter_names(parts))
        part = ControllerPart(parts.codec, needed_messages(parts.codec), assign, times, names=names)
        Node(part, exchange, name, clock, realtime).serve()
    yield Event("result", "", {"sentence": f"{command}: ended by the runner", "next": []})
