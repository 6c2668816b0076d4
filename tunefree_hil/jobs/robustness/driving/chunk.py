"""The drives of a chunk, graded; of a drive its grade is kept, never its recording."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from tunefree_hil.bench.batch import Batch, Driven
from tunefree_hil.config.tuning.require_schema import REQUIREMENTS
from tunefree_hil.jobs.robustness.plan import SweepDrive, SweepPlan
from tunefree_hil.jobs.tune.margins import JobDriver


class DriveRow(NamedTuple):
    """One drive as it is stored.

    Attributes:
        outcome: 'finished', or the name of what ended the drive.
        score: None where the bench ended the drive, not the gains.
        values: Of REQUIREMENTS, in their order; None where there is no finite value.
    """

    road: int
    car: int
    vector: int
    outcome: str
    score: float | None
    replans: int
    ticks: int
    values: tuple[float | None, ...]


class FinishedChunk(NamedTuple):
    """A chunk by its number, with its drives in the order of the plan."""

    number: int
    rows: list[DriveRow]

    def as_data(self) -> dict[str, Any]:
        """Plain data for JSON and for a cluster."""
        return {"chunk": self.number, "drives": [[*row[:-1], list(row.values)] for row in self.rows]}


def chunk_from_data(data: Any) -> FinishedChunk:
    """The inverse of `FinishedChunk.as_data`."""
    return FinishedChunk(data["chunk"], [_row_from_data(row) for row in data["drives"]])


def _row_from_data(row: Any) -> DriveRow:
    return DriveRow._make([*row[:-1], tuple(row[-1])])


def open_sweep_batch(plan: SweepPlan) -> Batch:
    """The batch that drives a plan; the caller closes it."""
    return Batch(plan.bench, plan.order.model, extra_effects=plan.maker.effects)


def drive_chunk(driver: JobDriver, plan: SweepPlan, number: int) -> FinishedChunk:
    """Drive a chunk."""
    drives = plan.list_drives(number)
    driven = driver.drive([plan.make_job(drive) for drive in drives])
    return FinishedChunk(number, [_make_row(drive, result) for drive, result in zip(drives, driven, strict=True)])


def drive_locally(plan: SweepPlan, numbers: Iterable[int]) -> Iterator[FinishedChunk]:
    """Drive chunks on the threads of this machine."""
    with open_sweep_batch(plan) as batch:
        for number in numbers:
            yield drive_chunk(batch, plan, number)


def _make_row(drive: SweepDrive, driven: Driven) -> DriveRow:
    grade = driven.grade
    if grade is None:
        return DriveRow(*drive, driven.error, None, 0, driven.ticks, (None,) * len(REQUIREMENTS))
    values = tuple(_finite(grade.requirements.get(name)) for name in REQUIREMENTS)
    return DriveRow(*drive, grade.outcome, grade.score, grade.replans, driven.ticks, values)


def _finite(value: float | None) -> float | None:
    """The value as a plain float; None where it is not finite, as of a drive that diverged."""
    return float(value) if value is not None and math.isfinite(value) else None
