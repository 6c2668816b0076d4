"""The command `gap`: what a model lacks, from logs."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.errors import InputError
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
    drive: Annotated[
        bool, typer.Option("--drive", help="where several names are left, drive what tells them apart, and ask again")
    ] = False,
    bench: Annotated[Path | None, typer.Option(help="with --drive: its verify model is what is driven")] = None,
    bus: Annotated[
        str, typer.Option(help="with --drive: auto, tfhub, socketcan:vcan0, or virtual: within this process")
    ] = "auto",
    workers: Annotated[
        int, typer.Option(min=1, max=8, help="processes that share the search; 1 where others are at work here")
    ] = 2,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Name what a simulation lacks, add it, and show the gap shrink.

    Says where they part, what it is with value and interval, or that these logs cannot tell; writes the repaired model
    and proves it on parts of the logs that no fit has seen. Where they leave several names, --drive has a bench drive
    what tells them apart. Cut off, the same command goes on.
    """

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.gap.gap import Asked
        from tunefree_hil.jobs.gap.gap import gap as run

        asked = Asked(logs, vehicle, model, out, older or [], until.value, workers)
        if not drive:
            if bench is not None:
                hint = "add --drive, or leave it out"
                raise InputError("a bench is named and nothing is to be driven", code="usage", key="--bench", hint=hint)
            return run(asked)
        if bench is None:
            hint = "--drive --bench BENCH: its verify model must be the car that the logs are of"
            raise InputError("no bench is named that drives", code="usage", key="--drive", hint=hint)
        from tunefree_hil.jobs.gap.drive import Wish, gap_drive

        return gap_drive(asked, Wish(bench, bus))

    return present("gap", job, plain=plain, as_json=as_json)
