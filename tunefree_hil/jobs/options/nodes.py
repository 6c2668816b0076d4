"""The options of the processes of a bench: `hub`, `ecu`, and those that `controller` and `collector` share with it."""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

from tunefree_hil.jobs.options.option import DEFAULT_SESSION, BenchBus, Bus, Model, Option, Realtime, Session


class NodeLink(NamedTuple):
    """Where a node finds its bench."""

    bus: Bus = "auto"
    bench_bus: BenchBus = ""
    session: Session = DEFAULT_SESSION
    realtime: Realtime = False


class EcuOptions(NamedTuple):
    """Options of `ecu`. scenario: drive this one once, without runner and bench channel, for any sender of commands."""

    model: Model = None
    scenario: Annotated[
        str | None,
        Option("without runner: drive this scenario in real time with commands from the bus (canplayer)", last=True),
    ] = None


class HubProcessOptions(NamedTuple):
    """The options of `hub`."""

    session: Session = DEFAULT_SESSION
    clock: Annotated[Literal["sender", "real"], Option("time stamps: of the sender (lockstep) or real time")] = "sender"
    transport: Annotated[Literal["unix", "tcp"], Option("transport of the peers; tcp on loopback only")] = "unix"
    owned: Annotated[bool, Option("end with the process that started it")] = False
