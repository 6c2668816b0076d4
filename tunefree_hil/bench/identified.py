"""What a bench's controller knows of the vehicle beyond the data sheet: steering map and delays, from the model folder.

The model is the one that the tuner drives (learned from logs), never the one that `verify` drives.
"""

from __future__ import annotations

import math
from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench.load import Bench, model_of
from tunefree_hil.config.learned.steering_map_schema import STEERING_MAP_FILE, SteeringMapSpec, load_steering_map
from tunefree_hil.config.schema import DATA_SHEET_STEERING, ActuatorSpec, ModelSpec, value_of
from tunefree_hil.control.build import Identified, identified_of_data_sheet
from tunefree_hil.control.contract import LoopDelays, VehicleConstants
from tunefree_hil.control.steering_map import SteeringMap, data_sheet_map, with_geometry


def identified_of(bench: Bench, vehicle: VehicleConstants) -> Identified:
    """Steering map and delays of the bench's model; what it does not state is the data sheet's."""
    model = model_of(bench, bench.spec.model)
    return Identified(steering_of(bench, model, vehicle), delays_of(model, vehicle, bench.dt_s))


def steering_of(bench: Bench, model: ModelSpec, vehicle: VehicleConstants) -> SteeringMap:
    """The steering map that the bench file chooses; of a model without one, the map of its fitted axles.

    Raises:
        InputError: The file is not there, does not fit, or is of another vehicle.
    """
    path = steering_map_path(bench)
    if path is not None:
        return map_from_file(load_steering_map(path), bench)
    if bench.spec.controller.steering_map == DATA_SHEET_STEERING or not model.actuators:
        return data_sheet_map(vehicle)
    return map_of_plant(model, vehicle)


def steering_map_path(bench: Bench) -> Path | None:
    """File of the steering map: the bench file's own, else that of its model where it has one."""
    choice = bench.spec.controller.steering_map
    if choice == DATA_SHEET_STEERING:
        return None
    if choice:
        beside = Path(bench.file).parent / choice
        return beside if beside.is_file() else Path(choice)
    of_model = Path(model_of(bench, bench.spec.model).folder) / STEERING_MAP_FILE
    return of_model if of_model.is_file() else None


def map_from_file(spec: SteeringMapSpec, bench: Bench) -> SteeringMap:
    """The map of a file. Raises InputError where it is of another vehicle, or of an earlier state of its folder."""
    vehicle = bench.vehicle
    is_other = spec.vehicle != vehicle.name
    if is_other or spec.vehicle_hash.removeprefix("sha256:") not in ("", vehicle.hash):
        problem = f"is of {spec.vehicle!r}" if is_other else "was learned before the vehicle's folder was changed"
        raise InputError(
            f"{problem}; the bench's vehicle is {vehicle.name!r}",
            code="steering_map_of_other_vehicle" if is_other else "vehicle_changed",
            file=spec.path,
            key="vehicle" if is_other else "vehicle_hash",
            hint="learn the steering map again, or name another one in controller.steering_map",
        )
    numbers = {name: getattr(spec.coefficients, name).value for name in spec.coefficients.__struct_fields__}
    return SteeringMap(
        **numbers,
        curvature_bound_1pm=spec.curvature_bound_1pm,
        lateral_accel_bound_mps2=spec.lateral_accel_bound_mps2,
    )


def delays_of(model: ModelSpec, vehicle: VehicleConstants, dt_s: float) -> LoopDelays:
    """Dead times and lags of a model's actuators, and of the bench; the data sheet's of a model without actuators."""
    if not model.actuators:
        return identified_of_data_sheet(vehicle).delays
    steer = model.actuators.get("steer", ActuatorSpec())
    drive = [model.actuators[name] for name in ("throttle", "brake") if name in model.actuators]
    slowest = max(drive, key=lambda spec: value_of(spec.dead_time_s) + equivalent_lag_s(spec), default=ActuatorSpec())
    ticks = model.timing.report_ticks + model.timing.command_ticks
    return LoopDelays(
        value_of(steer.dead_time_s),
        equivalent_lag_s(steer),
        value_of(slowest.dead_time_s),
        equivalent_lag_s(slowest),
        ticks * dt_s,
    )


def map_of_plant(model: ModelSpec, vehicle: VehicleConstants) -> SteeringMap:
    """The map of a model's fitted axles and of the geometry; the data sheet's axles where the model has none."""
    fitted = {name: model.plant.params[name] for name in VehicleConstants._fields if name in model.plant.params}
    return with_geometry(data_sheet_map(vehicle._replace(**fitted)))


def equivalent_lag_s(spec: ActuatorSpec) -> float:
    """The lag of an actuator; of a second-order one the first-order lag with its phase slope, 2 damping / omega."""
    if spec.order == 1:
        return value_of(spec.lag_s)
    natural_radps = 2.0 * math.pi * value_of(spec.natural_hz)
    return 2.0 * value_of(spec.damping) / natural_radps if natural_radps > 0.0 else 0.0
