"""Checks before a drive that the vehicle can drive the course, so that a score depends on the controller."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ScenarioSpec, VehicleSpec


class CourseLimits(NamedTuple):
    """Limits of a vehicle for a course; infinite where unknown."""

    curvature_1pm: float = math.inf
    curvature_rate_1pmps: float = math.inf  # 1/m per second
    lateral_accel_mps2: float = math.inf
    accel_low_mps2: float = -math.inf
    accel_high_mps2: float = math.inf
    speed_mps: float = math.inf


def limits_of(vehicle: VehicleSpec) -> CourseLimits:
    """The limits that vehicle.toml implies: steering through ratio and wheelbase (kinematic), the rest as given.

    curvature = tan(steer / ratio) / wheelbase; its rate with the wheels straight ahead, where it is least.
    """
    limits, nominal = vehicle.limits, vehicle.nominal
    curvature, rate = math.inf, math.inf
    if nominal.wheelbase_m and nominal.steer_ratio:
        curvature = math.tan(min(limits.steer_rad / nominal.steer_ratio, 1.5)) / nominal.wheelbase_m
        rate = limits.steer_rate_radps / nominal.steer_ratio / nominal.wheelbase_m
    return CourseLimits(
        curvature_1pm=curvature,
        curvature_rate_1pmps=rate,
        lateral_accel_mps2=limits.lateral_accel_mps2,
        accel_low_mps2=limits.accel_mps2[0],
        accel_high_mps2=limits.accel_mps2[1],
        speed_mps=limits.speed_mps,
    )


def check_feasible(course: Course, limits: CourseLimits) -> list[str]:
    """Violations of the limits: one sentence a quantity, with the time of its worst point. [] if none."""
    speed = np.asarray(course.speed_mps)
    accel = np.asarray(course.accel_mps2)
    curvature = curvature_by_time(course)
    rate = np.diff(curvature) / course.dt_s
    checks = (
        ("speed", "m/s", speed, limits.speed_mps),
        ("acceleration", "m/s2", np.maximum(accel, 0.0), limits.accel_high_mps2),
        ("deceleration", "m/s2", np.minimum(accel, 0.0), -limits.accel_low_mps2),
        ("curvature", "1/m", curvature, limits.curvature_1pm),
        ("curvature rate (steering rate)", "1/m/s", rate, limits.curvature_rate_1pmps),
        ("lateral acceleration", "m/s2", speed * speed * curvature, limits.lateral_accel_mps2),
    )
    problems = [_problem(what, unit, values, limit, course.dt_s) for what, unit, values, limit in checks]
    return [problem for problem in problems if problem]


def require_feasible(spec: ScenarioSpec, course: Course, limits: CourseLimits) -> None:
    """Raise InputError that names the scenario's file and every violation of the vehicle's limits."""
    problems = check_feasible(course, limits)
    if problems:
        raise InputError(
            f"scenario {spec.name!r} cannot be driven: " + "; ".join(problems),
            code="infeasible_scenario",
            file=spec.path,
            hint="lower the speed, stretch the breakpoints in time, or take a vehicle that can",
        )


def curvature_by_time(course: Course) -> np.ndarray:
    """Curvature of the path at the station of each tick, 1/m, `ticks + 1` values."""
    stations = course.first_station_m + np.arange(len(course.path_curvature_1pm)) * course.spacing_m
    return np.interp(np.asarray(course.station_m), stations, np.asarray(course.path_curvature_1pm))


def _problem(label: str, unit: str, values: np.ndarray, limit: float, dt_s: float) -> str:
    worst = int(np.argmax(np.abs(values)))
    if abs(values[worst]) <= limit:
        return ""
    return f"{label} {values[worst]:.3g} {unit} at t = {worst * dt_s:.2f} s, the limit is {limit:.3g} {unit}"
