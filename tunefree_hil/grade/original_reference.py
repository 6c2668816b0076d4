"""Errors against the original path, independent of the re-plans of a drive (docs/reference/grading.md).

Until the first re-plan the recorded errors are used. From then on lateral and heading error are taken against the path
itself; station and speed error against the plan, whose time and station are reset to the vehicle's at each re-plan
without blending the speed. Speed along the path and yaw rate (INS) are recovered from the follower's columns. Points
are projected as in control/path.py (agreement 1e-9 m); the plan's time is reset by control/schedule.py.
"""

from __future__ import annotations

import math

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.control.follower import MIN_ARC_SCALE
from tunefree_hil.control.schedule import Schedule, station_at, time_of
from tunefree_hil.episode.recording import ERROR_COLUMNS, Recording
from tunefree_hil.grade.metrics import MetricSamples, samples_from_recording
from tunefree_hil.grade.path_projection import DriveProjection, course_arrays, estimate_stations, project_points

Array = np.ndarray

MIN_COS = 1e-3


def samples_against_original(recording: Recording, course: Course, rear_axle_m: float) -> MetricSamples:
    """Samples of a recording with the errors against the original path.

    After a re-plan, errors that need a missing position or a missing recorded error are None.

    Args:
        rear_axle_m: Rear axle (INS point) to centre of mass.
    """
    current = samples_from_recording(recording)
    replan = recording.get("replan")
    anchors = np.flatnonzero(replan > 0.5) if replan is not None else np.empty(0, dtype=int)
    if len(anchors) == 0:
        return current
    if not {"x_m", "y_m", "heading_rad"} <= recording.columns.keys():
        return current._replace(**dict.fromkeys(ERROR_COLUMNS))
    first = int(anchors[0]) + 1  # at the tick of a re-plan the errors are still against the old trajectory
    recomputed = _recompute(recording, course, rear_axle_m, anchors)
    joined = {
        name: _join(getattr(current, name), getattr(recomputed, name), first) for name in (*ERROR_COLUMNS, *_REFERENCES)
    }
    return current._replace(**joined)


_REFERENCES = ("ref_speed_mps", "ref_accel_mps2", "ref_curvature_1pm")


def _join(before: Array | None, after: Array | None, first: int) -> Array | None:
    return None if before is None or after is None else np.concatenate([before[:first], after[first:]])


def _recompute(recording: Recording, course: Course, rear_axle_m: float, anchors: Array) -> MetricSamples:
    """Samples from the first re-plan on, against the original path and the re-anchored plan."""
    x, y, heading = (recording.columns[name] for name in ("x_m", "y_m", "heading_rad"))
    plan, first = course_arrays(course), int(anchors[0])
    near_m = estimate_stations(plan, x, y)
    rear_projection = project_points(plan, x, y, near_m, first)
    ahead_x, ahead_y = rear_axle_m * np.cos(heading), rear_axle_m * np.sin(heading)
    com_projection = project_points(plan, x + ahead_x, y + ahead_y, near_m + rear_axle_m, first)
    shift_s, offset_m = _plan_offsets(course, rear_projection.station_m, anchors)
    plan_s = np.arange(recording.ticks) * course.dt_s - shift_s
    ref_speed = np.interp(plan_s, plan.plan_s, plan.plan_speed_mps)
    beyond_m = np.maximum(plan_s - plan.plan_s[-1], 0.0) * plan.plan_speed_mps[-1]
    ref_station = np.interp(plan_s, plan.plan_s, plan.plan_station_m) + beyond_m + offset_m
    current = samples_from_recording(recording)
    along, yaw_rate = _follower_speeds(current)
    heading_error = _wrap_rad(heading - com_projection.heading_rad)
    lateral_rate = None
    if along is not None:
        lateral_rate = _ins_speed(along, rear_projection, heading) * np.sin(heading_error)
    return current._replace(
        ref_speed_mps=ref_speed,
        ref_accel_mps2=np.interp(plan_s, plan.plan_s, plan.plan_accel_mps2),
        ref_curvature_1pm=com_projection.curvature_1pm,
        station_error_m=ref_station - rear_projection.station_m,
        speed_error_mps=None if along is None else ref_speed - along,
        lateral_error_m=com_projection.lateral_m,
        lateral_error_rate_mps=lateral_rate,
        heading_error_rad=heading_error,
        heading_error_rate_radps=None if yaw_rate is None else yaw_rate - com_projection.curvature_1pm * ref_speed,
    )


def _follower_speeds(current: MetricSamples) -> tuple[Array | None, Array | None]:
    """Speed along the path and yaw rate that the follower used, recovered from its errors."""
    speed, curvature = current.ref_speed_mps, current.ref_curvature_1pm
    along = yaw_rate = None
    if speed is not None and current.speed_error_mps is not None:
        along = speed - current.speed_error_mps
    if speed is not None and curvature is not None and current.heading_error_rate_radps is not None:
        yaw_rate = current.heading_error_rate_radps + curvature * speed
    return along, yaw_rate


def _ins_speed(along: Array, rear_projection: DriveProjection, heading: Array) -> Array:
    """INS speed from the rate of the station (the inverse of control/follower.py `speed_along`).

    NaN where the vehicle stands across the path, because the inverse does not exist there.
    """
    cos = np.cos(heading - rear_projection.heading_rad)
    arc_scale = np.maximum(1.0 - rear_projection.curvature_1pm * rear_projection.lateral_m, MIN_ARC_SCALE)
    return along * arc_scale / np.where(np.abs(cos) > MIN_COS, cos, np.nan)


def _plan_offsets(course: Course, station_m: Array, anchors: Array) -> tuple[Array, Array]:
    """Delay of the plan in s and offset of its station in m at every row, reset after each re-plan."""
    # stops are not used here: the station table stands in for theirs
    schedule = Schedule(course.dt_s, course.station_m, course.speed_mps, course.accel_mps2, course.station_m)
    shift_s, offset_m = np.zeros(len(station_m)), np.zeros(len(station_m))
    late_s = 0.0
    for row in anchors.tolist():
        anchor_m, time_s = float(station_m[row]), row * course.dt_s
        if not math.isfinite(anchor_m):
            continue
        plan_s = time_of(schedule, time_s - late_s, anchor_m)
        late_s = time_s - plan_s
        shift_s[row + 1 :] = late_s
        offset_m[row + 1 :] = anchor_m - station_at(schedule, plan_s)
    return shift_s, offset_m


def _wrap_rad(angle_rad: Array) -> Array:
    return angle_rad - 2.0 * math.pi * np.ceil((angle_rad - math.pi) / (2.0 * math.pi))
