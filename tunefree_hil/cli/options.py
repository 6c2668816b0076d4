"""Options that several commands share: one name, one meaning, one help text."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

DEFAULT_SESSION = "default"

Bench = Annotated[Path, typer.Argument(help="bench file, such as bench_configs/mkz_steer.toml")]
RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="folder of a run, such as runs/20260101-120000-mkz_steer")]
Bus = Annotated[str, typer.Option(help="auto, tfhub, tfhub:ADDRESS, socketcan:vcan0 or virtual")]
BenchBus = Annotated[str, typer.Option(help="another virtual link for the bench channel: socketcan:vcan1")]
Join = Annotated[bool, typer.Option("--join", help="the hub and the nodes run already (other terminals)")]
Model = Annotated[str | None, typer.Option(help="another model than the bench file's")]
Out = Annotated[Path | None, typer.Option(help="where run folders go; default: runs")]
Realtime = Annotated[bool, typer.Option("--realtime", help="at 100 Hz of wall time instead of lockstep")]
Seed = Annotated[int | None, typer.Option(min=0, help="another seed than the file's")]
Session = Annotated[str, typer.Option(help="name that keeps two benches on one machine apart")]
Vehicle = Annotated[str | None, typer.Option(help="vehicle folder or its name in dbc/")]
Plain = Annotated[bool, typer.Option("--plain", help="one line an event")]
AsJson = Annotated[bool, typer.Option("--json", help="one JSON object on stdout, last")]


def session_of(session: str, join: bool) -> str:
    """The session to use: a joined bench is the one that hub, ecu and controller open by default."""
    return session or (DEFAULT_SESSION if join else "")
