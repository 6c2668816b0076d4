"""Commands that are one process of a bench: hub, ecu, controller. They end by Ctrl-C, a signal, or with the hub."""

from __future__ import annotations

from collections.abc import Iterable

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.options.nodes import EcuOptions, HubProcessOptions, NodeLink
from tunefree_hil.jobs.options.option import BenchFile


@command("hub")
def hub(options: HubProcessOptions) -> Iterable[Event]:
    """Carry the frames of one bench and write its logs."""
    yield Event("note", f"hub of session {options.session}")
    from tunefree_hil.jobs.hub import hub as start

    yield from start(options)


@command("ecu")
def ecu(bench: BenchFile, options: EcuOptions, link: NodeLink) -> Iterable[Event]:
    """Run the simulated by-wire vehicle on the bus."""
    yield Event("note", f"ecu of {bench}")
    from tunefree_hil.jobs.ecu import ecu as start

    yield from start(bench, options, link)


@command("controller")
def controller(bench: BenchFile, link: NodeLink) -> Iterable[Event]:
    """Run the controller on the bus."""
    yield Event("note", f"controller of {bench}")
    from tunefree_hil.jobs.controller import controller as start

    yield from start(bench, link)
