"""The simulated by-wire vehicle as a separate process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tunefree_hil.base.clock import Clock
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_scenario
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.jobs.options.nodes import EcuOptions, NodeLink
from tunefree_hil.nodes.ecu import EcuPart
from tunefree_hil.nodes.exchange import Exchange

LEAD_S = 0.2  # from ready to tick 0


def ecu(bench: Path, options: EcuOptions, link: NodeLink) -> Iterator[Event]:
    """Serve episodes on the bus until the runner ends the node or the bus is lost.

    With `options.scenario` drive that one once in real time, without runner and bench channel, for any sender of
    command frames (cansend, canplayer, a foreign controller).
    """
    from tunefree_hil.bench import VehicleFor, load
    from tunefree_hil.jobs.running.node_links import open_exchange, timing_folder
    from tunefree_hil.nodes.node import Announcement, Node
    from tunefree_hil.nodes.timing import CycleTimes

    parts, scenario = load(bench), options.scenario
    alone = (parts.scenarios.get(scenario) or load_scenario(scenario, parts.file)) if scenario else None
    realtime = link.realtime or alone is not None
    assign = VehicleFor(parts, options.model or parts.spec.model, realtime=realtime, ahead=True)
    with open_exchange(parts, "ecu", link._replace(realtime=realtime), alone=alone is not None) as opened:
        exchange, clock, bus_text = opened
        yield Event("note", f"ecu: {parts.vehicle.name} ({assign.model_name}) on {bus_text}")
        part = EcuPart(parts.codec, assign, CycleTimes(timing_folder()))
        if alone is not None:
            yield Event("note", f"ecu: {alone.name}, {parts.course(alone).ticks * parts.dt_s:g} s, starts now")
            yield drive_alone(part, exchange, clock, alone)
            return
        Node(part, exchange, Announcement(assign.model_name), clock, realtime).serve()
    yield Event("result", "", {"sentence": "ecu: ended by the runner", "next": []})


def drive_alone(part: EcuPart, exchange: Exchange, clock: Clock, scenario: ScenarioSpec) -> Event:
    """Drive one scenario in real time without a runner; the result has the number of received command frames."""
    part.load(bytes.fromhex(scenario.hash)[:6], scenario.noise_seed, {})
    exchange.clear()
    part.realtime(exchange, clock, clock.now_s() + LEAD_S, lambda message: False)
    sentence = f"ecu: {scenario.name} driven to its end; {exchange.heard} command frames received"
    return Event("result", "", {"sentence": sentence, "heard": exchange.heard, "next": []})
