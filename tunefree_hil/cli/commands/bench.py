"""Commands that are one process of a bench: hub, ecu, controller. They end by Ctrl-C, a signal, or with the hub."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.options.nodes import NodeLink
from tunefree_hil.jobs.options.option import DEFAULT_SESSION, BenchFile, Model, Option, Session


@command("hub")
def hub(
    session: Session = DEFAULT_SESSION,
    clock: Annotated[
        str, Option("time stamps: of the sender (lockstep) or real time", choices=("sender", "real"))
    ] = "sender",
    transport: Annotated[str, Option("transport of the peers; tcp on loopback only", choices=("unix", "tcp"))] = "unix",
    owned: Annotated[bool, Option("end with the process that started it")] = False,
) -> Iterable[Event]:
    """Carry the frames of one bench and write its logs."""
    arguments = locals()
    yield Event("note", f"hub of session {session}")
    from tunefree_hil.jobs.hub import hub as start

    yield from start(**arguments)


@command("ecu")
def ecu(
    bench: BenchFile,
    *,
    model: Model = None,
    link: NodeLink,
    scenario: Annotated[
        str | None, Option("without runner: drive this scenario in real time with commands from the bus (canplayer)")
    ] = None,
) -> Iterable[Event]:
    """Run the simulated by-wire vehicle on the bus."""
    yield Event("note", f"ecu of {bench}")
    from tunefree_hil.jobs.ecu import ecu as start

    yield from start(bench, link, model=model, scenario=scenario)


@command("controller")
def controller(bench: BenchFile, link: NodeLink) -> Iterable[Event]:
    """Run the controller on the bus."""
    yield Event("note", f"controller of {bench}")
    from tunefree_hil.jobs.controller import controller as start

    yield from start(bench, link)
