"""Commands that are one process of a bench: hub, ecu, controller. They end by Ctrl-C, a signal, or with the hub."""

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
    """Clock of the time stamps of frames."""

    sender = "sender"
    real = "real"


class Transport(StrEnum):
    """Transport between hub and peers."""

    unix = "unix"
    tcp = "tcp"


def hub(
    session: Session = DEFAULT_SESSION,
    clock: Annotated[
        HubClock, typer.Option(help="time stamps: of the sender (lockstep) or real time")
    ] = HubClock.sender,
    transport: Annotated[Transport, typer.Option(help="transport of the peers; tcp on loopback only")] = Transport.unix,
    owned: Annotated[bool, typer.Option("--owned", help="end with the process that started it")] = False,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Carry the frames of one bench and write its logs."""

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
        str | None,
        typer.Option(help="without runner: drive this scenario in real time with commands from the bus (canplayer)"),
    ] = None,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Run the simulated by-wire vehicle on the bus."""

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
    """Run the controller on the bus."""

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.controller import controller as run

        return run(bench, bus=bus, bench_bus=bench_bus, session=session, realtime=realtime)

    return present("controller", job, plain=plain, as_json=as_json, first=f"controller of {bench}")
