"""Real drivers for the measure `weights`: the manually driven parts of the openlka minutes, and their roads.

These production cars were driven by a person wherever lane keeping and cruise control were off. No lane and no plan was
recorded, so the person's intention is not known: the road is the person's own speed and curvature after a low-pass.
Errors against it would be small by construction; only comfort and effort are compared, and the low-pass takes movements
out of the road that the person made and the generated drives then do not have to make. That favours the generated side.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tools.measures._ledger import ROOT
from tunefree_hil.base.units import RAD_PER_DEG
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec, StartSpec, with_source
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.metrics import MetricScales, compute_metric, samples_from_recording
from tunefree_hil.roads.generation import SCENARIO_SCHEMA, scenario_text

Array = np.ndarray

DATA = ROOT.parent / "shared" / "data" / "openlka"
ROW_S = 0.1
COMPARED = ("lateral_jerk_rms", "longitudinal_jerk_rms", "steer_rate_rms")  # what both sides have without a reference
ENGAGED = ("op_enable", "op_lat_enable", "op_long_enable", "acc_enable")
SLOWEST_MPS = 3.0  # curvature is yaw rate over speed
WILDEST_MPS2 = 12.0  # more is a jump of the device's yaw angle
SHORTEST_S = 12.0
START_S = 3.0  # not compared: the simulated vehicle starts without a history
ROADS_S = (0.3, 1.0)  # standard deviations of the Gaussian that makes the road of a drive: both are reported
SIGNAL_S = 0.15  # of the one over the compared signals of both sides: the rows of the recordings are 0.1 s apart
BREAKPOINT_S = 0.5
STEADY_MPS2 = 0.3  # lateral acceleration from which a row tells the steering ratio of a car


class HumanDrive(NamedTuple):
    """A manually driven part: signals every ROW_S, arrays of shape (n_rows,). wheel_rad: as of the bench's vehicle."""

    name: str
    speed_mps: Array
    yaw_rate_radps: Array
    wheel_rad: Array


def read_human_drives(wheel_per_curvature_m: float, folder: Path = DATA) -> list[HumanDrive]:
    """All manually driven parts of at least SHORTEST_S above SLOWEST_MPS.

    Args:
        wheel_per_curvature_m: Steering-wheel angle per curvature of the bench's vehicle (ratio x wheelbase), to which
            the wheel angles of a car are scaled by the slope that its own minutes show.
    """
    by_car: dict[str, list[HumanDrive]] = {}
    for path in sorted(folder.glob("*.csv")):
        by_car.setdefault(path.stem.rsplit("_", 1)[0], []).extend(_manual_parts(path))
    scaled = []
    for drives in by_car.values():
        scale = wheel_per_curvature_m / _wheel_per_curvature_m(drives) if drives else 1.0
        scaled += [drive._replace(wheel_rad=drive.wheel_rad * scale) for drive in drives]
    return scaled


def _manual_parts(path: Path) -> Iterator[HumanDrive]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    engaged = np.array([any(float(row[name] or 0.0) > 0.0 for name in ENGAGED) for row in rows])
    speed, yaw, wheel = (
        np.array([float(row[name]) for row in rows]) for name in ("vEgo", "body_yaw_angle", "op_state_steer_angle")
    )
    yaw_rate = -np.gradient(np.unwrap(yaw), ROW_S)  # the device's yaw angle is positive to the right
    is_used = (
        ~engaged & (speed > SLOWEST_MPS) & np.isfinite(yaw_rate + wheel) & (np.abs(yaw_rate * speed) < WILDEST_MPS2)
    )
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_used.astype(int), [0]])))
    for begin, end in edges.reshape(-1, 2):
        if (end - begin) * ROW_S >= SHORTEST_S:
            part = slice(begin, end)
            name = f"{path.stem}_{begin * ROW_S:.0f}s"
            yield HumanDrive(name, speed[part], yaw_rate[part], wheel[part] * RAD_PER_DEG)


def _wheel_per_curvature_m(drives: Sequence[HumanDrive]) -> float:
    """Slope of wheel angle over curvature, with an offset, over the turning rows of a car (least squares)."""
    curvature = np.concatenate([low_pass(d.yaw_rate_radps, 0.3) / d.speed_mps for d in drives])
    wheel = np.concatenate([low_pass(d.wheel_rad, 0.3) for d in drives])
    speed = np.concatenate([d.speed_mps for d in drives])
    turning = np.abs(curvature * speed * speed) > STEADY_MPS2
    design = np.column_stack([curvature[turning], np.ones(turning.sum())])
    return float(np.linalg.lstsq(design, wheel[turning], rcond=None)[0][0])


def road_of(drive: HumanDrive, sigma_s: float) -> ScenarioSpec:
    """The road and speed of a human drive, low-passed, as a scenario."""
    curvature = low_pass(drive.yaw_rate_radps, sigma_s) / low_pass(drive.speed_mps, sigma_s)
    step = round(BREAKPOINT_S / ROW_S)
    rows = np.arange(0, len(drive.speed_mps), step)
    times = [round(float(row) * ROW_S, 1) for row in rows]
    speed = np.round(low_pass(drive.speed_mps, sigma_s)[rows], 3).tolist()
    spec = ScenarioSpec(
        schema=SCENARIO_SCHEMA,
        name=drive.name,
        start=StartSpec(speed_mps=speed[0]),
        speed=ProfileSpec(t_s=times, value=speed),
        curvature=ProfileSpec(t_s=times, value=(np.round(curvature[rows], 6) + 0.0).tolist()),
    )
    return with_source(spec, "", hashlib.sha256(scenario_text(spec).encode()).hexdigest())


def human_metrics(drive: HumanDrive, steer_rate_radps: float) -> dict[str, float | None]:
    """The compared metrics of a human drive."""
    return _metrics(drive.speed_mps, drive.yaw_rate_radps, drive.wheel_rad, steer_rate_radps)


def generated_metrics(recording: Recording, n_rows: int, steer_rate_radps: float) -> dict[str, float | None]:
    """The same of a simulated drive, reduced to the rows and the bandwidth of the recorded ones."""
    ticks = round(ROW_S / recording.dt_s)
    speed, yaw_rate, wheel = (
        _row_means(recording.columns[name], ticks)[:n_rows] for name in ("speed_mps", "yaw_rate_radps", "cmd_steer_rad")
    )
    return _metrics(speed, yaw_rate, wheel, steer_rate_radps)


def _metrics(speed: Array, yaw_rate: Array, wheel: Array, steer_rate_radps: float) -> dict[str, float | None]:
    skipped = round(START_S / ROW_S)
    smooth = [low_pass(values, SIGNAL_S)[skipped:] for values in (speed, yaw_rate, wheel)]
    accel = np.gradient(smooth[0], ROW_S)
    columns = {"speed_mps": smooth[0], "yaw_rate_radps": smooth[1], "cmd_steer_rad": smooth[2], "accel_mps2": accel}
    scales = MetricScales(wheelbase_m=1.0, steer_rad=1.0, steer_rate_radps=steer_rate_radps, dt_s=ROW_S)
    samples = samples_from_recording(Recording(columns, ROW_S))
    return {name: compute_metric(name, samples, scales) for name in COMPARED}


def _row_means(values: Array, ticks: int) -> Array:
    known = np.flatnonzero(np.isfinite(values))
    filled = np.interp(np.arange(len(values)), known, values[known])
    rows = len(filled) // ticks
    return filled[: rows * ticks].reshape(rows, ticks).mean(axis=1)


def low_pass(values: Array, sigma_s: float) -> Array:
    """A Gaussian without lag; at the ends the window is cut and renormalised."""
    reach = max(1, round(4.0 * sigma_s / ROW_S))
    window = np.exp(-0.5 * (np.arange(-reach, reach + 1) * ROW_S / sigma_s) ** 2)
    return np.convolve(values, window, mode="same") / np.convolve(np.ones_like(values), window, mode="same")
