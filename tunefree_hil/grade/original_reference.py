"""Errors against the *original* path, whatever was re-planned on the way (design D11), from the columns and the course.

Until the first re-plan the current trajectory is the original one, so the columns are taken as they are. From then on:
lateral and heading error against the path itself; station and speed against the plan, whose clock and station are set
to where the vehicle is at each re-plan (it need not catch up) but which is not blended from the measured speed. Speed
along the path and yaw rate are the ones that the follower saw (the INS's), read back from its columns. The foot of a
point is defined as in control/path.py (there tick by tick, here all rows at once, to 1e-9 m the same), the plan's clock
is set by control/schedule.py itself.
"""

from __future__ import annotations

import math

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.control.follower import SHRINK_FLOOR
from tunefree_hil.control.schedule import Schedule, station_at, time_of
from tunefree_hil.episode.recording import ERROR_COLUMNS, Recording
from tunefree_hil.grade.metrics import Samples, samples_of
from tunefree_hil.grade.path_projection import Feet, find_feet, near_stations, tables_of

Array = np.ndarray

LEAST_COS = 1e-3


def samples_against_original(recording: Recording, course: Course, rear_axle_m: float) -> Samples:
    """As samples_of, but against the original path. rear_axle_m: rear axle (INS point) to centre of mass.

    Where position or an error against the current trajectory could not be had, the errors that need it are None after
    a re-plan.
    """
    current = samples_of(recording)
    replan = recording.get("replan")
    anchors = np.flatnonzero(replan > 0.5) if replan is not None else np.empty(0, dtype=int)
    if len(anchors) == 0:
        return current
    if not {"x_m", "y_m", "heading_rad"} <= recording.columns.keys():
        return current._replace(**dict.fromkeys(ERROR_COLUMNS))
    first = int(anchors[0]) + 1  # at the tick of a re-plan the errors are still against the old trajectory
    again = _recompute(recording, course, rear_axle_m, anchors)
    joined = {
        name: _join(getattr(current, name), getattr(again, name), first) for name in (*ERROR_COLUMNS, *_REFERENCES)
    }
    return current._replace(**joined)


_REFERENCES = ("ref_speed_mps", "ref_accel_mps2", "ref_curvature_1pm")


def _join(before: Array | None, after: Array | None, first: int) -> Array | None:
    return None if before is None or after is None else np.concatenate([before[:first], after[first:]])


def _recompute(recording: Recording, course: Course, rear_axle_m: float, anchors: Array) -> Samples:
    """All rows from the first re-plan on against the original path and the plan as it was re-anchored."""
    x, y, heading = (recording.columns[name] for name in ("x_m", "y_m", "heading_rad"))
    tables, first = tables_of(course), int(anchors[0])
    near_m = near_stations(tables, x, y)
    rear = find_feet(tables, x, y, near_m, first)
    ahead_x, ahead_y = rear_axle_m * np.cos(heading), rear_axle_m * np.sin(heading)
    mass = find_feet(tables, x + ahead_x, y + ahead_y, near_m + rear_axle_m, first)
    shift_s, offset_m = _clock(course, rear.station_m, anchors)
    plan_s = np.arange(recording.ticks) * course.dt_s - shift_s
    ref_speed = np.interp(plan_s, tables.plan_s, tables.plan_speed_mps)
    beyond_m = np.maximum(plan_s - tables.plan_s[-1], 0.0) * tables.plan_speed_mps[-1]
    ref_station = np.interp(plan_s, tables.plan_s, tables.plan_station_m) + beyond_m + offset_m
    current = samples_of(recording)
    along, yaw_rate = _seen(current)
    heading_error = _wrap(heading - mass.heading_rad)
    return current._replace(
        ref_speed_mps=ref_speed,
        ref_accel_mps2=np.interp(plan_s, tables.plan_s, tables.plan_accel_mps2),
        ref_curvature_1pm=mass.curvature_1pm,
        station_error_m=ref_station - rear.station_m,
        speed_error_mps=None if along is None else ref_speed - along,
        lateral_error_m=mass.lateral_m,
        lateral_error_rate_mps=None if along is None else _speed(along, rear, heading) * np.sin(heading_error),
        heading_error_rad=heading_error,
        heading_error_rate_radps=None if yaw_rate is None else yaw_rate - mass.curvature_1pm * ref_speed,
    )


def _seen(current: Samples) -> tuple[Array | None, Array | None]:
    """(speed along the path, yaw rate) as the follower took its errors from them."""
    speed, curvature = current.ref_speed_mps, current.ref_curvature_1pm
    along = yaw_rate = None
    if speed is not None and current.speed_error_mps is not None:
        along = speed - current.speed_error_mps
    if speed is not None and curvature is not None and current.heading_error_rate_radps is not None:
        yaw_rate = current.heading_error_rate_radps + curvature * speed
    return along, yaw_rate


def _speed(along: Array, rear: Feet, heading: Array) -> Array:
    """The INS's speed, of which `along` is the rate of the station (control/follower.py `speed_along`, the way back).

    NaN across the path, where it cannot be told.
    """
    cos = np.cos(heading - rear.heading_rad)
    shrink = np.maximum(1.0 - rear.curvature_1pm * rear.lateral_m, SHRINK_FLOOR)
    return along * shrink / np.where(np.abs(cos) > LEAST_COS, cos, np.nan)


def _clock(course: Course, station_m: Array, anchors: Array) -> tuple[Array, Array]:
    """(how late the plan runs, what is added to its station) at every row: set anew after each re-plan."""
    # the stops are not asked for here; a table of the same kind stands in for them
    schedule = Schedule(course.dt_s, course.station_m, course.speed_mps, course.accel_mps2, course.station_m)
    shift_s, offset_m = np.zeros(len(station_m)), np.zeros(len(station_m))
    late_s = 0.0
    for row in anchors.tolist():
        here_m, time_s = float(station_m[row]), row * course.dt_s
        if not math.isfinite(here_m):
            continue
        plan_s = time_of(schedule, time_s - late_s, here_m)
        late_s = time_s - plan_s
        shift_s[row + 1 :] = late_s
        offset_m[row + 1 :] = here_m - station_at(schedule, plan_s)
    return shift_s, offset_m


def _wrap(angle_rad: Array) -> Array:
    return angle_rad - 2.0 * math.pi * np.ceil((angle_rad - math.pi) / (2.0 * math.pi))
