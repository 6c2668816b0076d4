"""Options that several commands share: one name, one meaning, one help text."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

DEFAULT_SESSION = "default"
Record = TypeVar("Record")

Bench = Annotated[Path, typer.Argument(help="bench file, such as bench_configs/mkz_steer.toml")]
RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="folder of a run, such as runs/20260101-120000-mkz_steer")]
Bus = Annotated[str, typer.Option(help="auto, tfhub, tfhub:ADDRESS, socketcan:vcan0 or virtual")]
BenchBus = Annotated[str, typer.Option(help="another virtual link for the bench channel: socketcan:vcan1")]
Join = Annotated[bool, typer.Option("--join", help="use a hub and nodes that run already (other terminals)")]
Model = Annotated[str | None, typer.Option(help="model; default: as in the bench file")]
Out = Annotated[Path | None, typer.Option(help="where run folders go; default: runs")]
Realtime = Annotated[bool, typer.Option("--realtime", help="in real time (100 Hz) instead of lockstep")]
Seed = Annotated[int | None, typer.Option(min=0, help="seed; default: as in the file")]
Session = Annotated[str, typer.Option(help="name of the bench, where several run on one machine")]
Vehicle = Annotated[str | None, typer.Option(help="vehicle folder or its name in dbc/")]
Plain = Annotated[bool, typer.Option("--plain", help="one line an event")]
AsJson = Annotated[bool, typer.Option("--json", help="one JSON object on stdout, last")]


def session_of(session: str, join: bool) -> str:
    """The session to use; for a joined bench the default of hub, ecu and controller."""
    return session or (DEFAULT_SESSION if join else "")


def record_from(record: Callable[..., Record], arguments: Mapping[str, Any], **changes: Any) -> Record:
    """Build the options record of a job from the arguments of its command.

    Args:
        record: NamedTuple whose fields have the names of the command's arguments.
        arguments: `locals()`, taken in the first line of the command. Enum members become their values; an option that
            was not given (None) keeps the default of the record.
        changes: Values that replace arguments, and fields that no argument has.
    """
    fields = inspect.signature(record).parameters
    values = {name: _plain_value(arguments[name]) for name in fields if arguments.get(name) is not None}
    return record(**{**values, **changes})


def _plain_value(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value
