"""Drives of a car whose steering map is known: ratio, understeer, offset, dead zone, saturating tyres."""

from __future__ import annotations

import numpy as np

from tunefree_hil.config.load import load_vehicle
from tunefree_hil.control.contract import VehicleConstants
from tunefree_hil.control.steering_map import SteeringMap, data_sheet_map, steady_road_wheel_rad, with_geometry
from tunefree_hil.learn.drives.drive import Drive

DT_S = 0.01
VEHICLE = load_vehicle("mkz_bywire")
BASE = with_geometry(data_sheet_map(VehicleConstants()))
TRUTH = BASE._replace(understeer_s2pm=0.004, rear_slip_s2pm=0.005, lateral_accel_bound_mps2=8.0)
NOISE = {
    "report.steer_rad": 0.001,
    "ins.speed_mps": 0.01,
    "ins.yaw_rate_radps": 0.0007,
    "ins.x_m": 0.008,
    "ins.y_m": 0.008,
    "ins.heading_rad": 0.0007,
}
SPEEDS_MPS = (4.0, 8.0, 13.0, 18.0, 24.0)


def turning_drive(
    truth: SteeringMap = TRUTH,
    *,
    seconds: float = 240.0,
    seed: int = 1,
    speeds_mps: tuple[float, ...] = SPEEDS_MPS,
    lateral_mps2: float = 3.0,
    curvature_1pm: float = 0.1,
    noise: float = 1.0,
    name: str = "made",
) -> Drive:
    """A drive that weaves slowly while its speed changes; the wheel leads the turn by the lag of a car.

    lateral_mps2, curvature_1pm: the greatest of the weave.
    """
    chance = np.random.default_rng([seed, 7])
    n = round(seconds / DT_S)
    time_s = np.arange(n) * DT_S
    speed = np.interp(time_s, np.linspace(0.0, seconds, len(speeds_mps)), speeds_mps)
    peak = np.minimum(curvature_1pm, lateral_mps2 / np.maximum(speed, 0.1) ** 2)
    phase = chance.uniform(0.0, 6.0, 2)
    shape = 0.6 * np.sin(time_s / 3.7 + phase[0]) + 0.4 * np.sin(time_s / 1.54 + phase[1])
    curvature = peak * shape
    columns = _motion(truth, speed, curvature)
    columns["report.steer_rad"] = _wheel(truth, speed, curvature) + _lead(truth, speed, curvature)
    fields = {field: values + noise * NOISE[field] * chance.standard_normal(n) for field, values in columns.items()}
    fresh = {field: np.ones(n, dtype=bool) for field in fields}
    return Drive(name, f"sha256:{seed:064x}", DT_S, fields, fresh, np.ones(n, dtype=bool))


def without(drive: Drive, *fields: str) -> Drive:
    """The drive without these fields."""
    left = {name: values for name, values in drive.fields.items() if name not in fields}
    return drive._replace(fields=left, fresh={name: drive.fresh[name] for name in left})


def _wheel(truth: SteeringMap, speed: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """Steady wheel angle, with an ideal dead zone."""
    road = np.array([steady_road_wheel_rad(truth, *pair) for pair in zip(speed, curvature, strict=True)])
    return truth.steer_ratio * road + truth.dead_zone_rad * np.sign(road) + truth.offset_rad


def _lead(truth: SteeringMap, speed: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """What the wheel is ahead of the turn: yaw inertia and late reports, 30 ms and 4 ms for each m/s."""
    yaw_accel = np.gradient(speed * curvature, DT_S)
    return truth.steer_ratio * (0.03 / np.maximum(speed, 1.0) * truth.length_m + 0.004) * yaw_accel


def _motion(truth: SteeringMap, speed: np.ndarray, curvature: np.ndarray) -> dict[str, np.ndarray]:
    """Speed, yaw rate and pose of the rear axle."""
    behind_m = truth.rear_axle_m - truth.rear_slip_s2pm * speed * speed  # side-slip at the centre of mass / curvature
    yaw_rate = speed * curvature / np.sqrt(1.0 - (behind_m * curvature) ** 2)
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (yaw_rate[1:] + yaw_rate[:-1]) * DT_S)])
    course = heading - truth.rear_slip_s2pm * speed * yaw_rate
    dx, dy = speed * np.cos(course), speed * np.sin(course)
    x, y = (np.concatenate([[0.0], np.cumsum(0.5 * (d[1:] + d[:-1]) * DT_S)]) for d in (dx, dy))
    return {
        "ins.speed_mps": speed,
        "ins.yaw_rate_radps": yaw_rate,
        "ins.x_m": x,
        "ins.y_m": y,
        "ins.heading_rad": np.arctan2(np.sin(heading), np.cos(heading)),
    }
