"""The command `gap`: what a model lacks, from logs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.gap.options import GapDriveOptions, GapOptions
from tunefree_hil.jobs.options.option import Option


@command("gap")
def gap(
    options: GapOptions,
    *,
    drive: Annotated[bool, Option("if several effects are possible, drive what separates them and run again")] = False,
    drive_options: GapDriveOptions,
) -> Iterable[Event]:
    """Name the effects that a simulation lacks, and repair it.

    The answer says where simulation and logs differ, and which effect is missing with value and interval, or that these
    logs cannot tell. The repaired model is written and verified on parts of the logs that no fit used. If several
    effects remain possible, --drive lets a bench drive what separates them. Run the same command again to continue
    after an interruption.
    """
    if not drive:
        if drive_options.bench is not None:
            message, hint = "--bench has no meaning without --drive", "add --drive, or leave --bench out"
            raise InputError(message, code="usage", key="--bench", hint=hint)
        from tunefree_hil.jobs.gap.gap import run_gap

        return run_gap(options)
    if drive_options.bench is None:
        hint = "--drive --bench BENCH: its verify model must be the vehicle of the logs"
        raise InputError("--drive needs a bench file", code="usage", key="--drive", hint=hint)
    from tunefree_hil.jobs.gap.drive import run_gap_with_drives

    return run_gap_with_drives(options, drive_options)
