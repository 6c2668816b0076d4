"""Courses, a plain single-track vehicle and a calibration map that the control tests share."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest

from tunefree_hil.base.course import Course
from tunefree_hil.base.kernel import table
from tunefree_hil.base.records import Ins, Measurement, Report
from tunefree_hil.control.calibration_map import CalibrationMap, from_triples

DT_S = 0.01
SPACING_M = 0.1
PROLONGED_M = 20.0


def make_course(
    duration_s: float,
    speed: Callable[[float], float],
    curvature: Callable[[float], float] = lambda station_m: 0.0,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Course:
    """Speed by time, curvature by station; poses by fine midpoint integration."""
    ticks = round(duration_s / DT_S)
    speeds = [speed(k * DT_S) for k in range(ticks + 1)]
    stations = [0.0]
    for k in range(ticks):
        stations.append(stations[-1] + 0.5 * (speeds[k] + speeds[k + 1]) * DT_S)
    accels = [(speeds[min(k + 1, ticks)] - speeds[min(k + 1, ticks) - 1]) / DT_S for k in range(ticks + 1)]
    places = math.ceil(stations[-1] / SPACING_M)
    x, y, heading = pose
    rows = [(x, y, heading, curvature(0.0))]
    for i in range(places):
        for part in range(20):
            step_m = SPACING_M / 20
            middle = curvature((i + (part + 0.5) / 20) * SPACING_M)
            x += step_m * math.cos(heading + 0.5 * middle * step_m)
            y += step_m * math.sin(heading + 0.5 * middle * step_m)
            heading += middle * step_m
        rows.append((x, y, heading, curvature((i + 1) * SPACING_M)))
    more = round(PROLONGED_M / SPACING_M)
    first, last = rows[0], rows[-1]
    before = [_straight(first, -(more - i) * SPACING_M) for i in range(more)]
    after = [_straight(last, (i + 1) * SPACING_M) for i in range(more)]
    rows = before + rows + after
    return Course(
        DT_S,
        ticks,
        table(stations),
        table(speeds),
        table(accels),
        table([0.0] * (ticks + 1)),
        table([1.0] * (ticks + 1)),
        table([0.0] * (ticks + 1)),
        table([0.0] * (ticks + 1)),
        -PROLONGED_M,
        SPACING_M,
        *(table(row[i] for row in rows) for i in range(4)),
    )


def _straight(row: tuple[float, ...], run_m: float) -> tuple[float, float, float, float]:
    return row[0] + run_m * math.cos(row[2]), row[1] + run_m * math.sin(row[2]), row[2], 0.0


class Car(NamedTuple):
    """Kinematic single track on its rear axle with perfect actuators: what a controller test needs and no more."""

    x_m: float
    y_m: float
    heading_rad: float
    speed_mps: float
    road_wheel_rad: float = 0.0
    wheelbase_m: float = 2.8448

    @property
    def yaw_rate_radps(self) -> float:
        return self.speed_mps * math.tan(self.road_wheel_rad) / self.wheelbase_m

    def moved(self, road_wheel_rad: float, accel_mps2: float, dt_s: float = DT_S) -> Car:
        """A tick later (midpoint heading); it does not roll back."""
        speed = max(0.0, self.speed_mps + accel_mps2 * dt_s)
        middle = 0.5 * (self.speed_mps + speed)
        turn = middle * math.tan(road_wheel_rad) / self.wheelbase_m * dt_s
        heading = self.heading_rad + 0.5 * turn
        return Car(
            self.x_m + middle * dt_s * math.cos(heading),
            self.y_m + middle * dt_s * math.sin(heading),
            self.heading_rad + turn,
            speed,
            road_wheel_rad,
        )

    def ins(self) -> Ins:
        return Ins(self.x_m, self.y_m, self.heading_rad, self.speed_mps, 0.0, self.yaw_rate_radps)

    def measurement(self, steer_ratio: float = 16.0) -> Measurement:
        report = Report(steer_rad=self.road_wheel_rad * steer_ratio, speed_mps=self.speed_mps)
        return Measurement(report, self.ins())


def linear_map() -> CalibrationMap:
    """+/-6 m/s2 on duty 0.15 to 0.8 and -0.15 to -0.5, at all speeds."""
    speeds, accels, commands = [], [], []
    for speed in (0.0, 40.0):
        for accel, command in ((-6.0, -0.5), (-1e-6, -0.15), (0.0, 0.15), (6.0, 0.8)):
            speeds.append(speed)
            accels.append(accel)
            commands.append(command)
    return from_triples(speeds, accels, commands)


class Kit(NamedTuple):
    """The helpers above, as a fixture (test modules do not import one another)."""

    course: Any = make_course
    car: Any = Car
    linear_map: Any = linear_map
    dt_s: float = DT_S


@pytest.fixture(scope="session")
def kit() -> Kit:
    return Kit()
