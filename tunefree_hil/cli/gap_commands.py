"""The command `gap`: what a model lacks, from logs."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Plain
from tunefree_hil.cli.output import present


class Until(StrEnum):
    """How far it goes."""

    LOCATE = "locate"
    NAME = "name"
    REPAIR = "repair"
    VERIFY = "verify"


def gap(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="logs of one vehicle, in any format")],
    vehicle: Annotated[str, typer.Option(help="vehicle folder or its name in dbc/")],
    model: Annotated[str, typer.Option(help="model folder that is held against them")],
    out: Annotated[Path, typer.Option(help="folder to write: gap.json, gap.md, figures, model")],
    older: Annotated[
        list[Path] | None, typer.Option(metavar="LOG", help="a log that the model fitted before; may be repeated")
    ] = None,
    until: Annotated[Until, typer.Option(help="stop after this step")] = Until.VERIFY,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Name what a simulation lacks, add it, and show the gap shrink.

    Says where they part, what it is with value and interval, or that these logs cannot tell; writes the repaired model
    and proves it on parts of the logs that no fit has seen. Cut off, the same command goes on.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.gap import Asked
        from tunefree_hil.jobs.gap import gap as run

        return run(Asked(logs, vehicle, model, out, older or [], until.value))

    return present("gap", job, plain=plain, as_json=as_json)
