"""Options of `gap`, and the inputs that they name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from tunefree_hil.jobs.options.option import LOGS, VEHICLE, Option

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec
    from tunefree_hil.gap.selection.reasons import Reason
    from tunefree_hil.learn.drives.drive import Drive

STEPS = ("locate", "name", "repair", "verify")


class GapOptions(NamedTuple):
    """Options of the command. workers: processes that share the search; the result does not depend on their number."""

    logs: Annotated[Sequence[Path], LOGS]
    vehicle: Annotated[str, VEHICLE]
    model: Annotated[str, Option("model folder to compare with the logs")]
    out: Annotated[Path, Option("folder to write: gap.json, gap.md, figures, model")]
    older: Annotated[Sequence[Path], Option("a log that the model fitted before; may be repeated", metavar="LOG")] = ()
    until: Annotated[str, Option("stop after this step", choices=STEPS)] = "verify"
    workers: Annotated[
        int,
        Option("processes of the search; 1 on a machine that others use, too", minimum=1, maximum=8, last=True),
    ] = 2


class GapDriveOptions(NamedTuple):
    """Options of `gap --drive`, which needs a bench."""

    bench: Annotated[Path | None, Option("with --drive: bench file; its verify model is driven")] = None
    bus: Annotated[str, Option("with --drive: auto, tfhub, socketcan:vcan0, or virtual (within this process)")] = "auto"


class GapInputs(NamedTuple):
    """What an answer is computed from.

    Attributes:
        vehicle: Vehicle of the logs.
        original_model: The model as it is in its folder.
        model: The same with the numbers from its calibration logs (gap/validation/repair.py).
        drives: Drives of the logs in question.
        older: Drives of `--older`.
        excluded_logs: Why logs are left out.
    """

    vehicle: VehicleSpec
    original_model: ModelSpec
    model: ModelSpec
    drives: list[Drive]
    older: list[Drive]
    excluded_logs: tuple[Reason, ...] = ()
