"""The steering map of logs or of a model: fitted, written as steering_map.toml, and drawn."""

from __future__ import annotations

import shutil
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench.controller import constants_of
from tunefree_hil.bench.identified import map_of_plant
from tunefree_hil.config.learned.steering_map_schema import STEERING_MAP_FILE
from tunefree_hil.control.steering_map import (
    SteeringMap,
    data_sheet_map,
    steady_road_wheel_rad,
    wheel_rad,
    with_geometry,
)
from tunefree_hil.jobs.learn.options import MapOptions
from tunefree_hil.jobs.preconditions import VEHICLE_IS, ErrorPlace, require_model_of_vehicle
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.steering_map.file import (
    SteeringSource,
    describe_assumed,
    describe_fit,
    hashes_of_drives,
    write_steering_map,
)
from tunefree_hil.learn.steering_map.fit import SteeringFit, fit_steering_map, locate_turns
from tunefree_hil.learn.steering_map.regression import jackknife_half_width
from tunefree_hil.learn.steering_map.samples import SteadySamples, collect_steady_samples

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec
    from tunefree_hil.figures.learning.steering_map import SteeringCurve

CURVES, POINTS = 5, 61  # of the figure: speeds, and points of a curve
SPEED_SHARE = 0.12  # samples within this share of a speed are drawn with it
MAX_DOTS = 1500  # of a curve


def learn_steering_of_logs(
    drives: Sequence[Drive], vehicle: VehicleSpec, target: Path, figure: Path, model: ModelSpec | None = None
) -> Generator[Event, None, dict[str, Any]]:
    """Fit and write the map of logs. Logs that cannot tell it are no error: the bench takes the model's axles.

    Args:
        target: The file to write.
        figure: The picture to write.
        model: Gives what is not fitted; None for the data sheet.

    Returns:
        `steering_map` and `figures` for the result of a job; no `steering_map` where none is written.
    """
    try:
        samples = collect_steady_samples(drives, vehicle)
        base = base_map(vehicle, model)
    except InputError as error:
        yield Event("warning", f"no steering map: {error.message}")
        return {"figures": []}
    label = "data sheet" if model is None else "axles of the model"
    fit = fit_steering_map(samples, base, label)
    assumed = describe_assumed(fit)
    if not fit.fitted:
        yield Event("warning", f"no steering map: the logs tell none of its coefficients ({assumed[0]})")
        return {"figures": []}
    yield Event("note", f"steering map: {describe_fit(fit)}")
    if assumed:
        yield Event("note", f"steering map, assumed: {'; '.join(assumed)}")
    write_steering_map(target, fit, vehicle, SteeringSource.LOGS, hashes_of_drives(drives))
    return {"steering_map": str(target), "figures": [str(draw_steering_figure(figure, fit))]}


def learn_steering_of_folder(folder: Path, vehicle: VehicleSpec, drives: Sequence[Drive]) -> Iterator[Event]:
    """The map of a calibrated model folder, from its own logs, where it has none yet."""
    from tunefree_hil.config.load import load_model

    target = folder / STEERING_MAP_FILE
    if not target.is_file():
        figure = folder / "figures" / "steering_map.png"
        yield from learn_steering_of_logs(drives, vehicle, target, figure, load_model(folder))


def copy_steering_map(source: Path, target: Path) -> None:
    """Give a learned folder the map of its physics, which is made of the same logs."""
    if (source / STEERING_MAP_FILE).is_file():
        shutil.copyfile(source / STEERING_MAP_FILE, target / STEERING_MAP_FILE)


def map_model(options: MapOptions) -> Iterator[Event]:
    """The steering map of a model, given in the place of logs: driven in steady turns in simulation.

    Raises:
        InputError: The model is of another vehicle or cannot be driven, or its turns tell nothing.
    """
    from tunefree_hil.config.load import load_model, load_vehicle
    from tunefree_hil.jobs.learn.steady_turns import drive_steady_turns, make_turn_bench

    vehicle, model = load_vehicle(options.vehicle), load_model(options.logs[0])
    require_model_of_vehicle(model, vehicle, ErrorPlace("name a model of the vehicle", "LOG"), VEHICLE_IS)
    target = steering_target(options.out)
    yield Event("note", f"steady turns of {model.folder} in simulation")
    drives = drive_steady_turns(make_turn_bench(model, vehicle))
    fit = fit_steering_map(collect_steady_samples(drives, vehicle), base_map(vehicle, model), "axles of the model")
    assumed = describe_assumed(fit)
    if not fit.fitted:
        raise InputError(
            f"the steady turns tell no coefficient ({assumed[0]})",
            code="no_steady_turns",
            file=f"{model.folder}/model.toml",
            hint="learn the steering map from logs instead",
        )
    hashes = {Path(model.folder).name: f"sha256:{model.hash}"}
    write_steering_map(target, fit, vehicle, SteeringSource.MODEL, hashes)
    figure = draw_steering_figure(target.with_suffix(".png"), fit)
    sentence = f"steering map in {target}: {describe_fit(fit)}"
    yield Event("result", "", {"steering_map": str(target), "figures": [str(figure)], "sentence": sentence})


def is_model(logs: Sequence[Path]) -> bool:
    """Whether a model folder is named in the place of logs."""
    return len(logs) == 1 and (logs[0] / "model.toml").is_file()


def steering_target(out: Path) -> Path:
    """The steering map beside an open-loop map: steering_map.toml, or NAME_steering.toml beside NAME.npz."""
    if out.suffix != ".npz":
        return out / STEERING_MAP_FILE
    return out.with_name(STEERING_MAP_FILE if out.stem == "calibration" else f"{out.stem}_steering.toml")


def base_map(vehicle: VehicleSpec, model: ModelSpec | None) -> SteeringMap:
    """What is not fitted. Raises InputError where the data sheet lacks a constant."""
    constants = constants_of(vehicle)
    return with_geometry(data_sheet_map(constants)) if model is None else map_of_plant(model, constants)


def draw_steering_figure(path: Path, fit: SteeringFit) -> Path:
    """Wheel angle over curvature by speed, with fit and interval."""
    from tunefree_hil.figures.learning.steering_map import write_steering_picture

    estimate = fit.estimates["understeer_s2pm"]
    known = f"understeer {1e3 * estimate.value:.2f} ({1e3 * estimate.low:.2f} to {1e3 * estimate.high:.2f}) mrad s2/m"
    title = f"Steering map of {len(fit.samples.block)} samples: {known if estimate.known else 'understeer is assumed'}"
    return write_steering_picture(path, make_curves(fit), title)


def make_curves(fit: SteeringFit) -> list[SteeringCurve]:
    """The curves of the figure: at speeds spread over the samples."""
    samples = fit.samples
    if not len(samples.block):
        return []
    speeds = np.unique(np.round(np.quantile(samples.speed_mps, np.linspace(0.05, 0.95, CURVES)), 1))
    return [_make_curve(fit, float(speed)) for speed in speeds]


def _make_curve(fit: SteeringFit, speed_mps: float) -> SteeringCurve:
    from tunefree_hil.figures.learning.steering_map import SteeringCurve

    samples = _samples_near(fit.samples, speed_mps)
    curvature = locate_turns(samples, fit.steering).curvature_1pm
    reach = float(np.abs(curvature).max()) if len(curvature) else 0.0
    points = np.linspace(-reach, reach, POINTS)
    wheel = _wheel_angles(fit.steering, speed_mps, points)
    replicates = np.array([_wheel_angles(steering, speed_mps, points) for steering in fit.replicates])
    half = jackknife_half_width(replicates) if len(replicates) else np.zeros(POINTS)
    neutral = fit.steering._replace(understeer_s2pm=0.0, understeer_cubic_s6pm3=0.0)
    return SteeringCurve(
        speed_mps=speed_mps,
        sample_curvature_1pm=curvature,
        sample_wheel_rad=samples.wheel_rad,
        curvature_1pm=points,
        wheel_rad=wheel,
        low_rad=wheel - half,
        high_rad=wheel + half,
        neutral_rad=_wheel_angles(neutral, speed_mps, points),
    )


def _samples_near(samples: SteadySamples, speed_mps: float) -> SteadySamples:
    rows = np.flatnonzero(np.abs(samples.speed_mps - speed_mps) <= SPEED_SHARE * speed_mps)
    return samples.select(rows[:: max(1, len(rows) // MAX_DOTS)])


def _wheel_angles(steering: SteeringMap, speed_mps: float, curvature: np.ndarray) -> np.ndarray:
    angles = [wheel_rad(steering, steady_road_wheel_rad(steering, speed_mps, float(kappa))) for kappa in curvature]
    return np.array(angles)


def result_of(data: Mapping[str, Any], steering: Mapping[str, Any]) -> dict[str, Any]:
    """The result of a job with the steering map's file and picture."""
    added = {key: value for key, value in steering.items() if key != "figures"}
    return {**data, **added, "figures": [*data.get("figures", []), *steering["figures"]]}
