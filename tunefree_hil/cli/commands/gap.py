"""The command `gap`: what a model lacks, from logs."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import AsJson, Plain, record_from
from tunefree_hil.cli.output import present


class GapStep(StrEnum):
    """The step after which the command stops."""

    LOCATE = "locate"
    NAME = "name"
    REPAIR = "repair"
    VERIFY = "verify"


def gap(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="logs of one vehicle, in any format")],
    vehicle: Annotated[str, typer.Option(help="vehicle folder or its name in dbc/")],
    model: Annotated[str, typer.Option(help="model folder to compare with the logs")],
    out: Annotated[Path, typer.Option(help="folder to write: gap.json, gap.md, figures, model")],
    older: Annotated[
        list[Path] | None, typer.Option(metavar="LOG", help="a log that the model fitted before; may be repeated")
    ] = None,
    until: Annotated[GapStep, typer.Option(help="stop after this step")] = GapStep.VERIFY,
    drive: Annotated[
        bool, typer.Option("--drive", help="if several effects are possible, drive what separates them and run again")
    ] = False,
    bench: Annotated[Path | None, typer.Option(help="with --drive: bench file; its verify model is driven")] = None,
    bus: Annotated[
        str, typer.Option(help="with --drive: auto, tfhub, socketcan:vcan0, or virtual (within this process)")
    ] = "auto",
    workers: Annotated[
        int, typer.Option(min=1, max=8, help="processes of the search; 1 on a machine that others use, too")
    ] = 2,
    plain: Plain = False,
    as_json: AsJson = False,
) -> int:
    """Name the effects that a simulation lacks, and repair it.

    The answer says where simulation and logs differ, and which effect is missing with value and interval, or that these
    logs cannot tell. The repaired model is written and verified on parts of the logs that no fit used. If several
    effects remain possible, --drive lets a bench drive what separates them. Run the same command again to continue
    after an interruption.
    """
    arguments = locals()

    def job() -> Iterable[Event]:
        from tunefree_hil.jobs.gap.gap import run_gap
        from tunefree_hil.jobs.gap.options import GapDriveOptions, GapOptions

        options = record_from(GapOptions, arguments)
        if not drive:
            if bench is not None:
                message, hint = "--bench has no meaning without --drive", "add --drive, or leave --bench out"
                raise InputError(message, code="usage", key="--bench", hint=hint)
            return run_gap(options)
        if bench is None:
            hint = "--drive --bench BENCH: its verify model must be the vehicle of the logs"
            raise InputError("--drive needs a bench file", code="usage", key="--drive", hint=hint)
        from tunefree_hil.jobs.gap.drive import run_gap_with_drives

        return run_gap_with_drives(options, record_from(GapDriveOptions, arguments))

    return present("gap", job, plain=plain, as_json=as_json)
