"""The command `gap`: what a model lacks, from logs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command, record_from
from tunefree_hil.jobs.options.option import LOGS, VEHICLE, Option

STEPS = ("locate", "name", "repair", "verify")


@command("gap")
def gap(
    logs: Annotated[Sequence[Path], LOGS],
    vehicle: Annotated[str, VEHICLE],
    model: Annotated[str, Option("model folder to compare with the logs")],
    out: Annotated[Path, Option("folder to write: gap.json, gap.md, figures, model")],
    older: Annotated[Sequence[Path], Option("a log that the model fitted before; may be repeated", metavar="LOG")] = (),
    until: Annotated[str, Option("stop after this step", choices=STEPS)] = "verify",
    drive: Annotated[bool, Option("if several effects are possible, drive what separates them and run again")] = False,
    bench: Annotated[Path | None, Option("with --drive: bench file; its verify model is driven")] = None,
    bus: Annotated[
        str, Option("with --drive: auto, tfhub, socketcan:vcan0, or virtual (within this process)")
    ] = "auto",
    workers: Annotated[
        int, Option("processes of the search; 1 on a machine that others use, too", minimum=1, maximum=8)
    ] = 2,
) -> Iterable[Event]:
    """Name the effects that a simulation lacks, and repair it.

    The answer says where simulation and logs differ, and which effect is missing with value and interval, or that these
    logs cannot tell. The repaired model is written and verified on parts of the logs that no fit used. If several
    effects remain possible, --drive lets a bench drive what separates them. Run the same command again to continue
    after an interruption.
    """
    arguments = locals()
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
