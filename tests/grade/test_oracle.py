"""A second, plain implementation of the 42 metrics from docs/reference/apollo.md, compared on one drive."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from itertools import pairwise

import numpy as np
import pytest

from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec
from tunefree_hil.episode.recording import COLUMNS, make_recording
from tunefree_hil.episode.scenario import build_course
from tunefree_hil.grade.profile import DriveExtras, profile_drive
from tunefree_hil.grade.score import GradeVehicle
from tunefree_hil.grade.table import PUBLISHED

DT_S, ROWS, LENGTH_M, LIMIT_RAD, REST = 0.01, 900, 2.8448, 8.2, 0.15
CAR = GradeVehicle(LENGTH_M, 1.4224, LIMIT_RAD, 8.5, rest_pedal_frac=REST)
COURSE = build_course(
    ScenarioSpec(
        schema="tunefree.scenario/1",
        name="oracle",
        speed=ProfileSpec(t_s=[0.0, 3.0, 6.0, 9.0], value=[6.0, 6.0, 0.0, 0.0]),
        curvature=ProfileSpec(t_s=[0.0, 1.0, 2.5, 3.5, 9.0], value=[0.0, 0.08, 0.08, 0.0, 0.0]),
    ),
    DT_S,
)


def drawn() -> dict[str, np.ndarray]:
    """A drive at random, but for where it stands and for its places, which lie on the path."""
    chance = np.random.default_rng(5)
    columns = {name: chance.normal(0.0, 0.4, ROWS) for name in COLUMNS[2:]}
    at = COURSE.first_station_m + np.arange(len(COURSE.path_x_m)) * COURSE.spacing_m
    station = np.asarray(COURSE.station_m)[:ROWS] - 0.3
    columns |= {"x_m": np.interp(station, at, COURSE.path_x_m), "y_m": np.interp(station, at, COURSE.path_y_m)}
    columns["heading_rad"] = np.interp(station, at, COURSE.path_heading_rad) + chance.normal(0.0, 0.05, ROWS)
    columns |= {"ref_speed_mps": np.asarray(COURSE.speed_mps)[:ROWS], "speed_mps": np.asarray(COURSE.speed_mps)[:ROWS]}
    columns["ref_accel_mps2"] = np.asarray(COURSE.accel_mps2)[:ROWS]
    columns["ref_curvature_1pm"] = np.interp(station, at, COURSE.path_curvature_1pm)
    columns["accel_mps2"] = chance.normal(0.0, 3.0, ROWS)
    columns["yaw_rate_radps"] = chance.normal(0.0, 0.8, ROWS)
    columns["cmd_throttle_frac"] = REST + np.maximum(chance.normal(0.0, 0.2, ROWS), 0.0)
    columns["cmd_brake_frac"] = REST + np.maximum(chance.normal(0.0, 0.2, ROWS), 0.0)
    columns["replan"] = np.zeros(ROWS)
    return columns


DRIVE = drawn()
TIMES_S = np.random.default_rng(6).uniform(0.001, 0.012, ROWS)


def column(name: str) -> list[float]:
    return DRIVE[name].tolist()


def rms(values: Iterable[float]) -> float:
    kept = list(values)
    return math.sqrt(sum(value * value for value in kept) / (len(kept) - 1))


def share(values: Iterable[float], limit: float) -> float:
    kept = list(values)
    return sum(abs(value) >= limit for value in kept) / len(kept)


V_REF, A_REF, K_REF = column("ref_speed_mps"), column("ref_accel_mps2"), column("ref_curvature_1pm")
WHERE: dict[str, Callable[[int], bool]] = {
    "moving": lambda i: V_REF[i] >= 0.03,
    "harsh accel": lambda i: abs(A_REF[i]) >= 1.0,
    "harsh bend": lambda i: abs(K_REF[i]) >= 0.05,
    "all": lambda i: True,
}


def v(i: int) -> float:
    return max(abs(V_REF[i]), 1.0)


def c(i: int) -> float:
    return max(abs(K_REF[i]), 0.02852)


def normed(name: str, by: Callable[[int], float], where: str) -> float:
    values = column(name)
    return rms(values[i] / by(i) for i in range(ROWS) if WHERE[where](i))


def peak(name: str, threshold: float) -> float:
    return max(abs(value) for value in column(name)) / threshold


def slopes(values: list[float]) -> list[float]:
    """Differences of means over 10 rows, per second."""
    means = [sum(values[i : i + 10]) / 10.0 for i in range(0, len(values) - 9, 10)]
    return [(b - a) / 0.1 for a, b in pairwise(means)]


def again(values: list[float]) -> list[float]:
    return [(b - a) / 0.1 for a, b in pairwise(values)]


def idle(report: str, other: str) -> float:
    kept = [a for a, b in zip(column(report), column(other), strict=True) if b > REST + 0.005]
    return sum(kept) / len(kept)


def offsets() -> list[float]:
    x, y, heading, found = column("x_m"), column("y_m"), column("heading_rad"), []
    for i in range(ROWS - 10):
        gone = x[i + 10] - x[i], y[i + 10] - y[i]
        if math.hypot(*gone) >= 0.1:
            turn = math.atan2(gone[1], gone[0]) - heading[i + 5]
            found.append(math.atan2(math.sin(turn), math.cos(turn)) / math.pi)
    return found


SIDE = [speed * rate for speed, rate in zip(column("speed_mps"), column("yaw_rate_radps"), strict=True)]
STOP = next(i for i in range(ROWS) if abs(DRIVE["speed_mps"][i]) < 0.03)  # 0.3 m before the planned stop
LOADS = [time_s / DT_S for time_s in TIMES_S.tolist()]
EXPECTED: dict[str, float] = {
    "station_err_std": normed("station_error_m", v, "moving"),
    "station_err_std_harsh": normed("station_error_m", v, "harsh accel"),
    "speed_err_std": normed("speed_error_mps", v, "moving"),
    "speed_err_std_harsh": normed("speed_error_mps", v, "harsh accel"),
    "lateral_err_std": normed("lateral_error_m", lambda i: c(i) * v(i) * LENGTH_M, "moving"),
    "lateral_err_std_harsh": normed("lateral_error_m", lambda i: c(i) * v(i) * LENGTH_M, "harsh bend"),
    "lateral_err_rate_std": normed("lateral_error_rate_mps", lambda i: c(i) * v(i) * LENGTH_M, "moving"),
    "lateral_err_rate_std_harsh": normed("lateral_error_rate_mps", lambda i: c(i) * v(i) * LENGTH_M, "harsh bend"),
    "heading_err_std": normed("heading_error_rad", lambda i: c(i) * v(i), "moving"),
    "heading_err_std_harsh": normed("heading_error_rad", lambda i: c(i) * v(i), "harsh bend"),
    "heading_err_rate_std": normed("heading_error_rate_radps", lambda i: c(i) * v(i), "moving"),
    "heading_err_rate_std_harsh": normed("heading_error_rate_radps", lambda i: c(i) * v(i), "harsh bend"),
    "station_err_peak": peak("station_error_m", 1.0),
    "speed_err_peak": peak("speed_error_mps", 0.5),
    "lateral_err_peak": peak("lateral_error_m", 0.5),
    "lateral_err_rate_peak": peak("lateral_error_rate_mps", 0.5),
    "heading_err_peak": peak("heading_error_rad", 0.5236),
    "heading_err_rate_peak": peak("heading_error_rate_radps", 0.5236),
    "ending_station_err": abs(DRIVE["station_error_m"][STOP]) / 1.0,
    "ending_lateral_err": abs(DRIVE["lateral_error_m"][STOP]) / 0.5,
    "ending_heading_err": abs(DRIVE["heading_error_rad"][STOP]) / 0.5236,
    "replan_trajectory_count": 0.0,
    "control_error_code_count": 1.0 / ROWS,
    "acc_bad_sensation": share(column("accel_mps2"), 4.0),
    "jerk_bad_sensation": share(slopes(column("accel_mps2")), 2.0),
    "lateral_acc_bad_sensation": share(SIDE, 4.0),
    "lateral_jerk_bad_sensation": share(slopes(SIDE), 2.0),
    "heading_acc_bad_sensation": share(slopes(column("yaw_rate_radps")), 3.1416),
    "heading_jerk_bad_sensation": share(again(slopes(column("yaw_rate_radps"))), 1.5708),
    "throttle_control_usage": normed("cmd_throttle_frac", lambda i: 1.0, "all"),
    "throttle_control_usage_harsh": normed("cmd_throttle_frac", lambda i: 1.0, "harsh accel"),
    "brake_control_usage": normed("cmd_brake_frac", lambda i: 1.0, "all"),
    "brake_control_usage_harsh": normed("cmd_brake_frac", lambda i: 1.0, "harsh accel"),
    "steering_control_usage": normed("cmd_steer_rad", lambda i: LIMIT_RAD, "all"),
    "steering_control_usage_harsh": normed("cmd_steer_rad", lambda i: LIMIT_RAD, "harsh bend"),
    "throttle_deadzone_mean": idle("out_throttle_frac", "cmd_brake_frac"),
    "brake_deadzone_mean": idle("out_brake_frac", "cmd_throttle_frac"),
    "total_time_usage": rms(LOADS),
    "total_time_peak": max(LOADS),
    "total_time_exceeded_count": sum(load > 1.0 for load in LOADS) / ROWS,
    "pose_heading_offset_std": rms(offsets()),
    "pose_heading_offset_peak": max(abs(one) for one in offsets()),
}
FOUND = profile_drive(make_recording(DRIVE, DT_S), COURSE, CAR, extras=DriveExtras(TIMES_S, "control_error"))


def test_the_oracle_knows_all_42() -> None:
    assert set(EXPECTED) == set(PUBLISHED)


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_metric_is_what_the_source_prints(name: str) -> None:
    assert FOUND[name].value == pytest.approx(EXPECTED[name], rel=1e-9, abs=1e-12)
    assert EXPECTED[name] != 0.0 or name == "replan_trajectory_count", "a drive that says nothing about it"
