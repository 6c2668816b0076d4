"""From the breakpoints of a scenario to its Course (docs/reference/files.md) and its start.

Speed and curvature are linear in time between breakpoints, so station (quadratic in time) and heading (cubic) are
integrated exactly; x and y by Simpson's rule on half the spacing of the path table, with `math.sin/cos`, so the
tables do not depend on an array library.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course, Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import table
from tunefree_hil.config.check import PROFILES
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec

Array = np.ndarray

SPACING_M = 0.1
PROLONGED_M = 20.0  # straight extension at both ends
LEAST_ADVANCE_M = 1e-9  # below it a piece is standstill and adds nothing to the path


class ReferenceDrive(NamedTuple):
    """The reference drive on a time grid on which it is exact (ticks and breakpoints): arrays of equal length."""

    time_s: Array
    speed_mps: Array
    curvature_1pm: Array
    station_m: Array
    heading_rad: Array


def build_course(spec: ScenarioSpec, dt_s: float) -> Course:
    """The planned drive by time and its path by station, starting at the origin with heading 0.

    The number of ticks is the duration (last t_s of the speed) over dt_s, rounded down. accel_mps2 is the slope of the
    piece that begins at the tick; the last row has that of the last piece. At standstill the path
    does not advance: a change of curvature there is a step in the path (reported by check_feasible). Raises InputError
    for profiles that are not valid and for negative speed.
    """
    _check_profiles(spec)
    duration_s = spec.speed.t_s[-1]
    ticks = math.floor(duration_s / dt_s + 1e-6)
    if ticks < 1:
        raise InputError(f"lasts {duration_s} s, less than one tick of {dt_s} s", file=spec.path, key="speed.t_s")
    drive = integrate(spec)
    tick_times = np.arange(ticks + 1) * dt_s
    station, speed, accel = _by_time(drive, tick_times)
    x, y, heading, curvature = _by_station(drive)
    return Course(
        dt_s=dt_s,
        ticks=ticks,
        station_m=table(station),
        speed_mps=table(speed),
        accel_mps2=table(accel),
        grade_rad=table(_sample(spec.grade, tick_times, 0.0)),
        friction_frac=table(_sample(spec.friction, tick_times, 1.0)),
        bank_rad=table(_sample(spec.bank, tick_times, 0.0)),
        side_wind_mps2=table(_sample(spec.side_wind, tick_times, 0.0)),
        first_station_m=-PROLONGED_M,
        spacing_m=SPACING_M,
        path_x_m=table(x),
        path_y_m=table(y),
        path_heading_rad=table(heading),
        path_curvature_1pm=table(curvature),
    )


def start_of(spec: ScenarioSpec, course: Course) -> Start:
    """Position of the rear axle at tick 0: from station 0 of the path `along_m` ahead and `lateral_m` to the left."""
    i = round(-course.first_station_m / course.spacing_m)
    path_heading_rad = float(course.path_heading_rad[i])
    cosine, sine = math.cos(path_heading_rad), math.sin(path_heading_rad)
    return Start(
        x_m=float(course.path_x_m[i]) - spec.start.lateral_m * sine + spec.start.along_m * cosine,
        y_m=float(course.path_y_m[i]) + spec.start.lateral_m * cosine + spec.start.along_m * sine,
        heading_rad=path_heading_rad + spec.start.heading_rad,
        speed_mps=spec.start.speed_mps,
    )


def integrate(spec: ScenarioSpec) -> ReferenceDrive:
    """Station and heading at every breakpoint: exact, as speed and curvature are linear between them."""
    time = np.union1d(spec.speed.t_s, spec.curvature.t_s)
    time = time[time <= spec.speed.t_s[-1]]
    speed = _sample(spec.speed, time, 0.0)
    curvature = _sample(spec.curvature, time, 0.0)
    span = np.diff(time)
    middle = 0.25 * (speed[:-1] + speed[1:]) * (curvature[:-1] + curvature[1:])
    turned = span / 6.0 * (speed[:-1] * curvature[:-1] + 4.0 * middle + speed[1:] * curvature[1:])
    station = _running_sum(0.5 * span * (speed[:-1] + speed[1:]))
    return ReferenceDrive(time, speed, curvature, station, _running_sum(turned))


class TimePlan(NamedTuple):
    """Station, speed and acceleration at the ticks."""

    station_m: Array
    speed_mps: Array
    accel_mps2: Array


class StationPath(NamedTuple):
    """The path every SPACING_M, from -PROLONGED_M to beyond the end."""

    x_m: Array
    y_m: Array
    heading_rad: Array
    curvature_1pm: Array


def _by_time(drive: ReferenceDrive, time_s: Array) -> TimePlan:
    slope = np.diff(drive.speed_mps) / np.diff(drive.time_s)
    # 1e-9: a tick that is a breakpoint up to rounding belongs to the piece that begins there
    piece = np.clip(np.searchsorted(drive.time_s, time_s + 1e-9, side="right") - 1, 0, len(slope) - 1)
    since = time_s - drive.time_s[piece]
    speed = drive.speed_mps[piece] + slope[piece] * since
    station = drive.station_m[piece] + since * (drive.speed_mps[piece] + 0.5 * slope[piece] * since)
    return TimePlan(station, np.maximum(speed, 0.0), slope[piece])


def _by_station(drive: ReferenceDrive) -> StationPath:
    length_m = float(drive.station_m[-1])
    before = round(PROLONGED_M / SPACING_M)
    cells = before + math.ceil((length_m + PROLONGED_M) / SPACING_M)
    half = (np.arange(2 * cells + 1) - 2 * before) * (SPACING_M / 2.0)
    heading, curvature = _shape_at(drive, half)
    x = _simpson([math.cos(angle) for angle in heading.tolist()])
    y = _simpson([math.sin(angle) for angle in heading.tolist()])
    return StationPath(x - x[before], y - y[before], heading[::2], curvature[::2])


def _shape_at(drive: ReferenceDrive, station_m: Array) -> tuple[Array, Array]:
    """Heading and curvature at the stations: straight on before 0 and after the end."""
    moves = np.flatnonzero(np.diff(drive.station_m) > LEAST_ADVANCE_M)
    if len(moves) == 0:
        return np.zeros_like(station_m), np.zeros_like(station_m)
    starts = drive.station_m[moves]
    piece = moves[np.clip(np.searchsorted(starts, station_m, side="right") - 1, 0, len(moves) - 1)]
    span = drive.time_s[piece + 1] - drive.time_s[piece]
    accel = (drive.speed_mps[piece + 1] - drive.speed_mps[piece]) / span
    bend = (drive.curvature_1pm[piece + 1] - drive.curvature_1pm[piece]) / span
    speed, curvature = drive.speed_mps[piece], drive.curvature_1pm[piece]
    ahead = np.clip(station_m - drive.station_m[piece], 0.0, drive.station_m[piece + 1] - drive.station_m[piece])
    root = speed + np.sqrt(np.maximum(speed * speed + 2.0 * accel * ahead, 0.0))
    since = np.minimum(2.0 * ahead / np.where(root > 0.0, root, 1.0), span)
    turned = since * (
        speed * curvature + since * (0.5 * (speed * bend + accel * curvature) + since * accel * bend / 3.0)
    )
    inside = (station_m >= 0.0) & (station_m <= drive.station_m[-1])
    return drive.heading_rad[piece] + turned, np.where(inside, curvature + bend * since, 0.0)


def _simpson(values: list[float]) -> Array:
    """Integral from the first node to each node, from values at the nodes and midpoints."""
    f = np.array(values)
    return _running_sum(SPACING_M / 6.0 * (f[:-2:2] + 4.0 * f[1::2] + f[2::2]))


def _running_sum(steps: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(steps)])


def _sample(profile: ProfileSpec | None, time_s: Array, otherwise: float) -> Array:
    """A profile at the times: linear between breakpoints, flat outside them; `otherwise` without a profile."""
    if profile is None:
        return np.full(len(time_s), otherwise)
    return np.interp(time_s, profile.t_s, profile.value)


def _check_profiles(spec: ScenarioSpec) -> None:
    for key in PROFILES:
        profile = getattr(spec, key)
        if profile is None:
            continue
        message = _profile_problem(profile)
        if message:
            raise InputError(message, code="bad_profile", file=spec.path, key=key)
    if min(spec.speed.value) < 0.0:
        raise InputError(
            f"speed {min(spec.speed.value)} m/s is negative",
            code="bad_profile",
            file=spec.path,
            key="speed.value",
            hint="scenarios drive forward; reverse is not supported",
        )


def _profile_problem(profile: ProfileSpec) -> str:
    """The error in the breakpoints of a profile, or ''."""
    time = np.asarray(profile.t_s, dtype=float)
    if len(time) != len(profile.value) or len(time) < 2:
        return f"{len(time)} times and {len(profile.value)} values; there must be as many, and two at least"
    if not (np.isfinite(time).all() and np.isfinite(profile.value).all()):
        return "times and values must be finite"
    if time[0] != 0.0:
        return f"t_s begins at {time[0]}; it must begin at 0"
    if (np.diff(time) <= 0.0).any():
        index = int(np.argmax(np.diff(time) <= 0.0))
        return f"t_s must ascend; entry {index + 1} ({time[index + 1]}) does not"
    return ""
