"""The command `calibrate`: actuators and physical constants out of logs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Plain
from tunefree_hil.cli.output import present


def calibrate(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="logs of one vehicle, in any format")],
    vehicle: Annotated[str, typer.Option(help="vehicle folder or its name in dbc/")],
    out: Annotated[Path, typer.Option(help="model folder to write; it must not be there yet")],
    seed: Annotated[int, typer.Option(min=0, help="of the choice of what is held out")] = 1,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Identify actuators and physical constants from logs.

    Each with its interval. What the logs cannot show keeps the data sheet's value, widened, and is said. A model folder
    comes out that drive and tune take as it is. Last, the model's own logs are asked what it misses of them, which
    `gap` needs: a minute or two, and many where a model comes nowhere near its logs. The model is whole after that.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.learn.calibrate import calibrate as run

        return run(logs, vehicle, out, seed)

    return present("calibrate", job, plain=plain, as_json=as_json)
