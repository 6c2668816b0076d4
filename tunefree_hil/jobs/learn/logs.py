"""Logs for what learns from them (`calibrate`, `learn`, `map`): read, checked, and said how much they are."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec
    from tunefree_hil.learn.drives.drive import Drive

REAR_AXLE = "rear_axle"


def read(
    logs: Sequence[Path],
    vehicle: VehicleSpec,
    excused: Collection[str] = (),
    unsaid: Collection[str] = (),
    mend: Callable[[Drive], tuple[Drive, Sequence[str]]] = lambda drive: (drive, ()),
) -> Generator[Event, None, list[Drive]]:
    """The drives of logs, in their order; what is to be said of them on the way.

    excused: codes of refusals (learn/checks/drive_checks.py) that are no more than warnings to whoever asks; unsaid: codes that do
    not matter to them at all; mend: what they leave out of a drive before it is judged, with words for it. Raises
    InputError where no log is named, one cannot be read, or one is refused: before anything is learned, with all that
    is wrong.
    """
    from tunefree_hil.bus.dbc.codec import Codec
    from tunefree_hil.learn.checks.drive_checks import check_drives
    from tunefree_hil.learn.checks.problem import require_good
    from tunefree_hil.learn.drives.read import read_drives
    from tunefree_hil.learn.drives.validity import PLACE, without_held_pose, without_place, without_spikes

    if not logs:
        raise InputError("no log is named", code="no_log", key="LOG", hint="name one log or more")
    yield Event("note", f"reading {len(logs)} log{'s' if len(logs) > 1 else ''} of {vehicle.name}")
    drives = read_drives(list(logs), Codec(vehicle))
    if vehicle.ins_frame.point != REAR_AXLE and any(name in drive.fields for drive in drives for name in PLACE):
        words = f"{', '.join(PLACE)} are of {vehicle.ins_frame.point!r} (ins_frame.point), and not of the rear axle"
        yield Event("warning", f"{words}: they are left out, and where it was is summed up from speed and yaw rate")
        drives = [without_place(drive) for drive in drives]
    for i, drive in enumerate(drives):
        drives[i], left_out = without_spikes(drive)
        if left_out:
            said = ", ".join(f"{count} of {name}" for name, count in left_out.items())
            yield Event("warning", f"{drive.name}: single values that no car can have come to are left out: {said}")
        drives[i], words = mend(drives[i])
        yield from (Event("warning", f"{drive.name}: {one}") for one in words)
    problems = [one for one in check_drives(drives, vehicle) if one.code not in unsaid]
    for problem in require_good(one._replace(severity="warn") if one.code in excused else one for one in problems):
        yield Event("warning", problem.words)
    for i, drive in enumerate(drives):
        drives[i], held_s = without_held_pose(drive)
        if held_s:
            words = f"the INS says one place for {held_s:.0f} s of driving, which is left out"
            yield Event("warning", f"{drive.name}: {words}")
    yield Event("note", f"{sum(drive.ticks * drive.dt_s for drive in drives) / 60.0:.1f} minutes of driving")
    return drives
