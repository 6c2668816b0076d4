"""A pose that stands while the car drives: satellites are hidden, and the INS says again where it was.

Less than half of the driving of it is no fault (learn/check_stuck.py); it is no measurement either.
"""

from __future__ import annotations

import numpy as np

from tunefree_hil.learn.drives import Drive
from tunefree_hil.learn.fields import CHASSIS_FIRST_SPEEDS
from tunefree_hil.learn.runs import every_of, runs
from tunefree_hil.learn.series import first_of

PLACE = ("ins.x_m", "ins.y_m")
HELD_S = 1.0
LEAST_M = 1.0  # by its speed, that it is somewhere else by then
FRAMES = 4  # of a slow INS, that say the same


def without_place(drive: Drive) -> Drive:
    """The drive as if nobody had said where it was."""
    fields = {name: values for name, values in drive.fields.items() if name not in PLACE}
    return drive._replace(fields=fields, fresh={name: drive.fresh[name] for name in fields})


def without_held_pose(drive: Drive) -> tuple[Drive, float]:
    """(the drive without its place in such stretches, how many seconds they are)."""
    speed = first_of(drive, CHASSIS_FIRST_SPEEDS)
    if speed is None or any(name not in drive.fields for name in PLACE):
        return drive, 0.0
    stands = np.zeros(drive.ticks, dtype=bool)
    still = np.all([np.diff(drive.fields[name], prepend=np.nan) == 0.0 for name in PLACE], axis=0)
    least = max(round(HELD_S / drive.dt_s), round(FRAMES * every_of(drive.fresh[PLACE[0]])))
    for begin, end in runs(still, least):
        stands[begin:end] = float(np.nansum(np.abs(speed[begin:end]))) * drive.dt_s > LEAST_M
    if not stands.any():
        return drive, 0.0
    fields, fresh = dict(drive.fields), dict(drive.fresh)
    for name in PLACE:
        fields[name] = np.where(stands, np.nan, fields[name])
        fresh[name] = fresh[name] & ~stands
    return drive._replace(fields=fields, fresh=fresh), float(stands.sum()) * drive.dt_s
