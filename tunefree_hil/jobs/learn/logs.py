"""Reads and checks the logs of `calibrate`, `learn`, `map` and `gap`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec
    from tunefree_hil.learn.checks.problem import LogProblem
    from tunefree_hil.learn.drives.drive import Drive

REAR_AXLE = "rear_axle"
Mend = Callable[["Drive"], tuple["Drive", Sequence[str]]]


def read_logs(
    logs: Sequence[Path],
    vehicle: VehicleSpec,
    tolerated: Collection[str] = (),
    unreported: Collection[str] = (),
    mend: Mend = lambda drive: (drive, ()),
) -> Generator[Event, None, list[Drive]]:
    """The drives of logs, in their order, with notes and warnings on the way.

    Args:
        logs: Files to read.
        vehicle: Vehicle of the logs.
        tolerated: Codes of refusals (learn/checks/drive_checks.py) that are reported as warnings.
        unreported: Codes of problems that are not reported.
        mend: What to leave out of a drive before it is checked, with a text for each omission.

    Raises:
        InputError: No log is named, one cannot be read, or one is refused; the message has all problems.
    """
    from tunefree_hil.bus.dbc.codec import Codec
    from tunefree_hil.learn.checks.drive_checks import check_drives
    from tunefree_hil.learn.checks.problem import raise_refusals
    from tunefree_hil.learn.drives.read import read_drives
    from tunefree_hil.learn.drives.validity import drop_frozen_position

    if not logs:
        raise InputError("no log is named", code="no_log", key="LOG", hint="name one log or more")
    yield Event("note", f"reading {len(logs)} log{'s' if len(logs) > 1 else ''} of {vehicle.name}")
    drives = yield from _clean_drives(read_drives(list(logs), Codec(vehicle)), vehicle, mend)
    problems = [problem for problem in check_drives(drives, vehicle) if problem.code not in unreported]
    for problem in raise_refusals(_downgrade(problem, tolerated) for problem in problems):
        yield Event("warning", problem.message)
    for i, drive in enumerate(drives):
        drives[i], frozen_s = drop_frozen_position(drive)
        if frozen_s:
            text = f"the INS position is frozen for {frozen_s:.0f} s of driving, which are left out"
            yield Event("warning", f"{drive.name}: {text}")
    yield Event("note", f"{sum(drive.n_rows * drive.dt_s for drive in drives) / 60.0:.1f} minutes of driving")
    return drives


def _clean_drives(drives: list[Drive], vehicle: VehicleSpec, mend: Mend) -> Generator[Event, None, list[Drive]]:
    """Leave out positions of another point than the rear axle, single impossible values, and what `mend` leaves out."""
    from tunefree_hil.learn.drives.validity import POSITION_FIELDS, drop_position, remove_spikes

    point = vehicle.ins_frame.point
    if point != REAR_AXLE and any(name in drive.fields for drive in drives for name in POSITION_FIELDS):
        fields = f"{', '.join(POSITION_FIELDS)} are of {point!r} (ins_frame.point), not of the rear axle"
        yield Event("warning", f"{fields}: they are left out, and the position is integrated from speed and yaw rate")
        drives = [drop_position(drive) for drive in drives]
    for i, drive in enumerate(drives):
        drives[i], left_out = remove_spikes(drive)
        if left_out:
            counts = ", ".join(f"{count} of {name}" for name, count in left_out.items())
            yield Event("warning", f"{drive.name}: left out, as single values that no vehicle can reach: {counts}")
        drives[i], omissions = mend(drives[i])
        yield from (Event("warning", f"{drive.name}: {text}") for text in omissions)
    return drives


def _downgrade(problem: LogProblem, tolerated: Collection[str]) -> LogProblem:
    """A refusal of a tolerated code as a warning."""
    return problem._replace(severity="warn") if problem.code in tolerated else problem
