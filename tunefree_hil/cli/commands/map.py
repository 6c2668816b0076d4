"""The command that learns the open-loop map: map."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Plain
from tunefree_hil.cli.output import present

Logs = Annotated[list[Path], typer.Argument(metavar="LOG...", help="logs of the vehicle, in any format")]
Of = Annotated[str, typer.Option("--vehicle", help="vehicle folder or its name in dbc/")]
Target = Annotated[Path, typer.Option("--out", help="a file ending in .npz, or a folder (a model's: its own map)")]


def map_logs(
    logs: Logs,
    vehicle: Of,
    out: Target,
    seed: Annotated[int, typer.Option(min=0, help="of the nets and of what is held out")] = 1,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Learn the open-loop map from logs.

    Which pedal at which speed gives which acceleration, as the calibration.npz that the controller looks up.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.learn.map import map_logs as run

        return run(logs, vehicle, out, seed)

    return present("map", job, plain=plain, as_json=as_json)
