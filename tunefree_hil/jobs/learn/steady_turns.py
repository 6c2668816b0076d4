"""Steady turns of a model in simulation: what a learned plant says of its steering, as drives to be fitted.

Each turn holds a speed while the curvature goes slowly to one side, to the other and back, so that every tick is nearly
steady cornering. The bench's own controller drives, without a bus; its errors do not matter, as the wheel angle is the
measured one.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import parameters_of
from tunefree_hil.bench.batch import Batch
from tunefree_hil.bench.load import Bench, model_of
from tunefree_hil.bench.simulator import Job
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.config.load import load_weights
from tunefree_hil.config.schema import (
    BenchSpec,
    ControllerSpec,
    ModelSpec,
    ProfileSpec,
    ScenarioSpec,
    StartSpec,
    VehicleSpec,
)
from tunefree_hil.episode.feasible import limits_of
from tunefree_hil.episode.recording import Recording
from tunefree_hil.learn.drives.drive import Drive

LATERAL = "lqr_preview"  # keeps to the turns with a data sheet's map too, by its integral
# Gains that no dead time makes oscillate; tight tracking is not needed.
CALM_GAINS = {"lqr.q1": 0.02, "lqr.q3": 0.1, "mrac.enable": 0.0}
# Field of a drive -> column of a recording
FIELDS = {
    "report.steer_rad": "out_steer_rad",
    "report.speed_mps": "speed_mps",
    "report.yaw_rate_radps": "yaw_rate_radps",
    "ins.x_m": "x_m",
    "ins.y_m": "y_m",
    "ins.heading_rad": "heading_rad",
}
DriveJobs = Callable[[Sequence[Job]], Sequence[Recording | None]]


class SteadyTurnCriteria(NamedTuple):
    """How steady turns are driven; every value is an engineering choice."""

    speeds: int = 6  # from the lowest to the highest: a line in speed squared needs three
    low_mps: float = 3.0  # m/s; slower, the measured curvature is noisy
    max_speed_share: float = 0.9  # of the model's valid region and of the vehicle's limit
    max_lateral_share: float = 0.8  # of the model's valid region and of the vehicle's limit
    max_curvature_share: float = 0.8  # of the vehicle's steering range
    max_curvature_1pm: float = 0.15  # 1/m: 6.7 m of radius, tighter than any road of a scenario
    yaw_accel_radps2: float = 0.08  # rad/s2, of the ramps: half of what a sample may have
    wheel_rate_radps: float = 0.35  # rad/s of steering wheel, of the ramps: less than a sample may have
    understeer_s2pm: float = 0.006  # s2/m, for the rate of the wheel: more than most vehicles have
    hold_s: float = 3.0  # s, at the greatest curvature


CRITERIA = SteadyTurnCriteria()


def drive_steady_turns(bench: Bench, drive_jobs: DriveJobs | None = None) -> list[Drive]:
    """The turns of a bench's model, one drive for each speed.

    Args:
        bench: From `make_turn_bench`.
        drive_jobs: Drives jobs of the bench; None for the compiled batch.

    Raises:
        InputError: The model cannot be driven, or reports no yaw rate.
    """
    model = model_of(bench, bench.spec.model)
    values = parameters_of(bench, CALM_GAINS)
    jobs = [Job(values, scenario) for scenario in bench.scenarios.values()]
    recordings = _drive_batch(bench, jobs) if drive_jobs is None else drive_jobs(jobs)
    drives = [
        drive_from_recording(recording, job.scenario.name, model.hash)
        for job, recording in zip(jobs, recordings, strict=True)
        if recording is not None and {"yaw_rate_radps", "out_steer_rad"} <= recording.columns.keys()
    ]
    if not drives:
        raise InputError(
            "no steady turn of this model shows steering wheel and yaw rate",
            code="no_steady_turns",
            file=f"{model.folder}/model.toml",
            hint="learn the steering map from logs instead",
        )
    return drives


def make_turn_bench(model: ModelSpec, vehicle: VehicleSpec) -> Bench:
    """A bench of the model, whose scenarios are the turns."""
    scenarios = {scenario.name: scenario for scenario in make_turns(model, vehicle)}
    spec = BenchSpec(
        schema="tunefree.bench/1",
        vehicle=vehicle.folder,
        model=model.folder,
        scenarios=list(scenarios),
        controller=ControllerSpec(lateral=LATERAL),
        path="",
    )
    return Bench(spec, vehicle, Codec(vehicle), load_weights(spec.weights), scenarios, vehicle.tick_ms * 1e-3)


def make_turns(model: ModelSpec, vehicle: VehicleSpec) -> Iterator[ScenarioSpec]:
    """A turn to both sides at each speed, within the model's valid region and the vehicle's limits."""
    limits = limits_of(vehicle)
    top_mps = CRITERIA.max_speed_share * min(_reach(model.valid.speed_mps), limits.speed_mps)
    tightest_1pm = min(CRITERIA.max_curvature_share * limits.curvature_1pm, CRITERIA.max_curvature_1pm)
    ratio, length_m = vehicle.nominal.steer_ratio or 1.0, vehicle.nominal.wheelbase_m or 1.0
    wheel_rad = CRITERIA.max_curvature_share * min(_reach(model.valid.steer_rad), vehicle.limits.steer_rad)
    for speed_mps in np.linspace(CRITERIA.low_mps, max(top_mps, CRITERIA.low_mps), CRITERIA.speeds):
        reached_m = length_m + CRITERIA.understeer_s2pm * speed_mps * speed_mps
        # The controller's bound on the wheel is that of the limit without understeer (control/limits.py).
        bound_mps2 = limits.lateral_accel_mps2 * length_m / reached_m
        lateral_mps2 = CRITERIA.max_lateral_share * min(_reach(model.valid.lateral_accel_mps2), bound_mps2)
        curvature = min(tightest_1pm, lateral_mps2 / speed_mps**2, wheel_rad / ratio / reached_m)
        rate = min(CRITERIA.yaw_accel_radps2 / speed_mps, CRITERIA.wheel_rate_radps / ratio / reached_m)
        yield _make_turn(float(speed_mps), float(curvature), float(rate))


def _reach(region: Sequence[float] | None) -> float:
    """The greatest magnitude to both sides; infinite where the region is not known. A speed has one side."""
    if region is None:
        return math.inf
    low, high = region
    return min(-low, high) if low < 0.0 else high


def _make_turn(speed_mps: float, curvature_1pm: float, rate_1pmps: float) -> ScenarioSpec:
    ramp_s, hold_s = round(curvature_1pm / rate_1pmps, 1) + 1.0, CRITERIA.hold_s
    steps = (2.0, ramp_s, hold_s, 2.0 * ramp_s, hold_s, ramp_s, 2.0)
    times = [0.0, *np.round(np.cumsum(steps), 2).tolist()]
    curve = [0.0, 0.0, curvature_1pm, curvature_1pm, -curvature_1pm, -curvature_1pm, 0.0, 0.0]
    name = f"steady_turn_{speed_mps:.1f}mps"
    digest = hashlib.sha256(repr((name, times, curve)).encode()).hexdigest()
    return ScenarioSpec(
        schema="tunefree.scenario/1",
        name=name,
        start=StartSpec(speed_mps=speed_mps),
        speed=ProfileSpec(t_s=[0.0, times[-1]], value=[speed_mps, speed_mps]),
        curvature=ProfileSpec(t_s=times, value=curve),
        hash=digest,
    )


def _drive_batch(bench: Bench, jobs: Sequence[Job]) -> list[Recording | None]:
    with Batch(bench) as batch:
        return [driven.recording for driven in batch.drive(jobs, columns=True)]


def drive_from_recording(recording: Recording, name: str, model_hash: str) -> Drive:
    """The columns of a simulated drive as a drive of `learn`."""
    fields = {field: recording.columns[column] for field, column in FIELDS.items() if column in recording.columns}
    fresh = {field: np.isfinite(values) for field, values in fields.items()}
    rows = len(next(iter(fields.values())))
    return Drive(name, f"sha256:{model_hash}", recording.dt_s, fields, fresh, np.ones(rows, dtype=bool))
