"""The command `calibrate`: actuators and physical constants from logs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Plain, record_from
from tunefree_hil.cli.output import present


def calibrate(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="logs of one vehicle, in any format")],
    vehicle: Annotated[str, typer.Option(help="vehicle folder or its name in dbc/")],
    out: Annotated[Path, typer.Option(help="model folder to write; it must not be there yet")],
    seed: Annotated[int, typer.Option(min=0, help="of the choice of the held-out parts")] = 1,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Identify actuators and physical constants from logs.

    Each has its interval. A parameter that the logs do not identify keeps the value of the data sheet with a wider
    interval, and is reported. The model folder can be used by drive and tune directly. At the end, the logs are
    analysed for what the model misses of them, which `gap` needs: this takes a minute or two, and longer for a model
    that is far from its logs. Run the same command again to continue after an interruption.
    """
    arguments = locals()

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.learn.calibrate import calibrate as run
        from tunefree_hil.jobs.learn.options import CalibrateOptions

        return run(record_from(CalibrateOptions, arguments))

    return present("calibrate", job, plain=plain, as_json=as_json)
