"""Commands that are one process of a bench: hub, ecu, controller. They end by Ctrl-C, a kill, or with the hub."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import (
    DEFAULT_SESSION,
    AsJson,
    Bench,
    BenchBus,
    Bus,
    Model,
    Plain,
    Realtime,
    Session,
)
from tunefree_hil.cli.output import present


class HubClock(StrEnum):
    """Whose time stamps a frame."""

    sender = "sender"
    real = "real"


class Transport(StrEnum):
    """How peers reach the hub."""

    unix = "unix"
    tcp = "tcp"


def hub(
    session: Session = DEFAULT_SESSION,
    clock: Annotated[HubClock, typer.Option(help="stamps: the sender's (lockstep) or real time")] = HubClock.sender,
    transport: Annotated[Transport, typer.Option(help="how peers reach it; tcp is loopback only")] = Transport.unix,
    owned: Annotated[bool, typer.Option("--owned", help="end when the one who started it is gone")] = False,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Carry the frames of one bench, write its logs."""

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.hub import hub as run

        return run(session=session, clock=clock.value, transport=transport.value, owned=owned)

    return present("hub", job, plain=plain, as_json=as_json, first=f"hub of session {session}")


def ecu(
    bench: Bench,
    model: Model = None,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    session: Session = DEFAULT_SESSION,
    realtime: Realtime = False,
    scenario: Annotated[
        str | None, typer.Option(help="no runner: drive this one in real time for whoever sends commands (canplayer)")
    ] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Be the simulated by-wire vehicle on the bus."""

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.ecu import ecu as run

        return run(
            bench,
            model=model,
            bus=bus,
            bench_bus=bench_bus,
            session=session,
            realtime=realtime,
            scenario=scenario,
        )

    return present("ecu", job, plain=plain, as_json=as_json, first=f"ecu of {bench}")


def controller(
    bench: Bench,
    bus: Bus = "auto",
    bench_bus: BenchBus = "",
    session: Session = DEFAULT_SESSION,
    realtime: Realtime = False,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Be the controller on the bus."""

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.controller import controller as run

        return run(bench, bus=bus, bench_bus=bench_bus, session=session, realtime=realtime)

    return present("controller", job, plain=plain, as_json=as_json, first=f"controller of {bench}")
