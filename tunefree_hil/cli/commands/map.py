"""The command `map`: learns the open-loop map from logs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Plain, record_from
from tunefree_hil.cli.output import present

LogArguments = Annotated[list[Path], typer.Argument(metavar="LOG...", help="logs of the vehicle, in any format")]
VehicleOption = Annotated[str, typer.Option("--vehicle", help="vehicle folder or its name in dbc/")]
MapTarget = Annotated[
    Path, typer.Option("--out", help="a file ending in .npz, or a folder (a model folder: its own map)")
]


def map_logs(
    logs: LogArguments,
    vehicle: VehicleOption,
    out: MapTarget,
    seed: Annotated[int, typer.Option(min=0, help="of the nets and the held-out cells")] = 1,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Learn the open-loop map from logs.

    The map gives the acceleration for every pedal position and speed, as the calibration.npz that the controller uses.
    """
    arguments = locals()

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.learn.map import map_logs as run
        from tunefree_hil.jobs.learn.options import MapOptions

        return run(record_from(MapOptions, arguments))

    return present("map", job, plain=plain, as_json=as_json)
