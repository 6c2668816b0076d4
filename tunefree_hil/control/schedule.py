"""The speed plan of a Course by time, and how it is shifted and blended after a re-plan (docs/reference/grading.md)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.course import Course
from tunefree_hil.base.kernel import kernel, table

STOPPED_MPS = 1e-3  # a slower row without positive acceleration is a stop (docs/reference/apollo.md)
PULL_AWAY_MPS2 = 0.01


class Schedule(NamedTuple):
    """Rows at k * dt_s; stop_station_m[k] is where the next stop at or after row k stands, else the path's end."""

    dt_s: float
    station_m: Any
    speed_mps: Any
    accel_mps2: Any
    stop_station_m: Any


class Blend(NamedTuple):
    """Offsets of the current trajectory from the planned one; all zero before the first re-plan.

    Time: the plan runs `shift_s` late. Speed: an offset that fades over the blend, whose integral is `station_m`.
    Place: a lateral offset, a quintic in station from (lateral_m, slope, 0) at from_station_m to 0 after length_m.
    """

    shift_s: float
    from_s: float
    speed_mps: float
    station_m: float
    from_station_m: float
    length_m: float
    lateral_m: float
    slope: float


def make_schedule(course: Course) -> Schedule:
    """The rows of a Course with the stops found; without a further stop, the end of the path."""
    place_m = course.first_station_m + (len(course.path_x_m) - 1) * course.spacing_m
    stops = []
    for k in range(len(course.station_m) - 1, -1, -1):
        if abs(course.speed_mps[k]) < STOPPED_MPS and course.accel_mps2[k] <= PULL_AWAY_MPS2:
            place_m = course.station_m[k]
        stops.append(place_m)
    return Schedule(course.dt_s, course.station_m, course.speed_mps, course.accel_mps2, table(reversed(stops)))


def no_blend() -> Blend:
    """The planned trajectory as it is."""
    return Blend(0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)


@kernel
def row_at(schedule: Schedule, plan_s: float) -> tuple[int, float]:
    """(row, share of the way to the next) at a time of the plan, limited to the ends."""
    last = len(schedule.station_m) - 1
    at = plan_s / schedule.dt_s
    if at <= 0.0:
        return 0, 0.0
    if at >= last:
        return last, 0.0
    row = int(math.floor(at))  # noqa: RUF046 - a compiled floor gives a float
    return row, at - row


@kernel
def plan_at(schedule: Schedule, plan_s: float) -> tuple[float, float]:
    """(speed, acceleration) of the plan at a time; after the end that of the last row."""
    row, share = row_at(schedule, plan_s)
    speed_mps, accel_mps2 = float(schedule.speed_mps[row]), float(schedule.accel_mps2[row])
    if share > 0.0:
        speed_mps += share * (schedule.speed_mps[row + 1] - speed_mps)
        accel_mps2 += share * (schedule.accel_mps2[row + 1] - accel_mps2)
    return speed_mps, accel_mps2


@kernel
def station_at(schedule: Schedule, plan_s: float) -> float:
    """Station of the plan at a time; beyond the end it runs on at the last speed."""
    row, share = row_at(schedule, plan_s)
    station_m = float(schedule.station_m[row])
    if share > 0.0:
        return station_m + share * (schedule.station_m[row + 1] - station_m)
    last = len(schedule.station_m) - 1
    if row == last:
        return station_m + schedule.speed_mps[last] * (plan_s - last * schedule.dt_s)
    return station_m


@kernel
def time_of(schedule: Schedule, plan_s: float, station_m: float) -> float:
    """The time of the plan nearest to `plan_s` at which it is at `station_m`.

    Forward it does not pass a stop (a vehicle that overran its stop still waits there), backward it does. Where the
    plan does not reach the station, the nearest time: the caller uses the rest as an offset of the station.
    """
    rows, speeds = schedule.station_m, schedule.speed_mps
    last = len(rows) - 1
    began, _ = row_at(schedule, plan_s)
    row = began
    while row > 0 and rows[row] > station_m:
        row -= 1
    while row < last and rows[row + 1] <= station_m and speeds[row] >= STOPPED_MPS:
        row += 1
    ahead_m = station_m - rows[row]
    if row == last:
        beyond_s = 0.0
        if ahead_m > 0.0 and speeds[last] > STOPPED_MPS:
            beyond_s = ahead_m / speeds[last]
        return last * schedule.dt_s + beyond_s
    step_m = rows[row + 1] - rows[row]
    if step_m <= ahead_m:  # at a stop or past it: keep waiting
        return plan_s if row == began else row * schedule.dt_s
    if ahead_m <= 0.0:
        return row * schedule.dt_s
    return (row + ahead_m / step_m) * schedule.dt_s


@kernel
def speed_blend(blend: Blend, blend_s: float, time_s: float) -> tuple[float, float]:
    """(speed offset, its rate) at a time: fades as 1 - 3 u^2 + 2 u^3 over `blend_s`."""
    if blend.speed_mps == 0.0 or blend_s <= 0.0:
        return 0.0, 0.0
    u = (time_s - blend.from_s) / blend_s
    if u >= 1.0 or u < 0.0:
        return 0.0, 0.0
    fade = 1.0 - u * u * (3.0 - 2.0 * u)
    rate_1ps = 6.0 * u * (u - 1.0) / blend_s
    return blend.speed_mps * fade, blend.speed_mps * rate_1ps


@kernel
def reference_at(schedule: Schedule, blend: Blend, blend_s: float, time_s: float) -> tuple[float, float]:
    """(speed, acceleration) of the current trajectory at a time. The speed is not negative."""
    speed_mps, accel_mps2 = plan_at(schedule, time_s - blend.shift_s)
    offset_mps, rate_mps2 = speed_blend(blend, blend_s, time_s)
    speed_mps += offset_mps
    if speed_mps < 0.0:
        return 0.0, 0.0
    return speed_mps, accel_mps2 + rate_mps2


@kernel
def lateral_blend(blend: Blend, station_m: float) -> tuple[float, float, float]:
    """(lateral offset, slope, second derivative by station) of the current trajectory against the path."""
    run_m = station_m - blend.from_station_m
    if run_m >= blend.length_m or (blend.lateral_m == 0.0 and blend.slope == 0.0):
        return 0.0, 0.0, 0.0
    if run_m <= 0.0:
        return blend.lateral_m + blend.slope * run_m, blend.slope, 0.0
    length_m = blend.length_m
    u = run_m / length_m
    rest = 1.0 - u
    # Quintic Hermite: the offset's and the slope's basis functions, both flat to second order at u = 1.
    start = rest * rest * rest * (1.0 + u * (3.0 + 6.0 * u))
    lean = rest * rest * rest * u * (1.0 + 3.0 * u)
    start_1 = -30.0 * u * u * rest * rest
    lean_1 = 1.0 + u * u * (-18.0 + u * (32.0 - 15.0 * u))
    start_2 = -60.0 * u * rest * (1.0 - 2.0 * u)
    lean_2 = u * (-36.0 + u * (96.0 - 60.0 * u))
    offset_m = blend.lateral_m * start + blend.slope * length_m * lean
    slope = blend.lateral_m / length_m * start_1 + blend.slope * lean_1
    bend_1pm = (blend.lateral_m / length_m * start_2 + blend.slope * lean_2) / length_m
    return offset_m, slope, bend_1pm
