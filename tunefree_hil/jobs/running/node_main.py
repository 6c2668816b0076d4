"""How a process in the controller's place serves episodes: the controller's own, and the planner of a collection."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load, needed_messages
from tunefree_hil.jobs.running.node_links import open_exchange, timing_folder
from tunefree_hil.nodes.controller import Assignment, ControllerPart
from tunefree_hil.nodes.node import Node
from tunefree_hil.nodes.timing import CycleTimes

OURS = "lqr_pid_mrac"  # what our controller calls itself on the bench channel
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
    own: Callable[[Bench], Iterable[str]] = lambda bench: (),
) -> Iterator[Event]:
    """Serve until the runner says end or the bus is gone.

    `assign_for`: what gives each episode its Block. `command`: which of ours this is, in words to a person; `name`:
    what drives, in its hello on the bench channel; `own`: the parameters that it announces there.
    """
    parts = load(bench)
    with open_exchange(parts, "controller", bus, bench_bus, session, realtime=realtime) as (exchange, clock, where):
        yield Event("note", f"{command}: {parts.vehicle.name} on {where}")
        times = CycleTimes(timing_folder())
        assign, names = assign_for(parts), list(own(parts))
        part = ControllerPart(parts.codec, needed_messages(parts.codec), assign, times, names=names)
        Node(part, exchange, name, clock, realtime).serve()
    yield Event("result", "", {"sentence": f"{command}: told to end", "next": []})
