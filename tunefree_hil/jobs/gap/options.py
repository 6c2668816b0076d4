"""Options of `gap`, and the inputs that they name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec
    from tunefree_hil.gap.selection.reasons import Reason
    from tunefree_hil.learn.drives.drive import Drive


class GapOptions(NamedTuple):
    """Options of the command. workers: processes that share the search; the result does not depend on their number."""

    logs: Sequence[Path]
    vehicle: str
    model: str
    out: Path
    older: Sequence[Path] = ()
    until: str = "verify"
    workers: int = 2


class GapDriveOptions(NamedTuple):
    """Options of `gap --drive`: the bench file, and the bus between its nodes."""

    bench: Path
    bus: str = "auto"
    session: str = ""


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
