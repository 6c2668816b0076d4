"""What a bench's controller knows of the vehicle beyond the data sheet: steering map and delays, from the model folder.

The model is the one that the tuner drives (learned from logs), never the one that `verify` drives.
"""

from __future__ import annotations

import math

from tunefree_hil.bench.load import Bench, model_of
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, value_of
from tunefree_hil.control.build import Identified, identified_of_data_sheet
from tunefree_hil.control.contract import LoopDelays, VehicleConstants
from tunefree_hil.control.steering_map import SteeringMap, data_sheet_map, with_geometry


def identified_of(bench: Bench, vehicle: VehicleConstants) -> Identified:
    """Steering map and delays of the bench's model; what it does not state is the data sheet's."""
    model = model_of(bench, bench.spec.model)
    from_data_sheet = identified_of_data_sheet(vehicle)
    if not model.actuators:
        return from_data_sheet
    steer = model.actuators.get("steer", ActuatorSpec())
    drive = [model.actuators[name] for name in ("throttle", "brake") if name in model.actuators]
    slowest = max(drive, key=lambda spec: value_of(spec.dead_time_s) + equivalent_lag_s(spec), default=ActuatorSpec())
    ticks = model.timing.report_ticks + model.timing.command_ticks
    delays = LoopDelays(
        value_of(steer.dead_time_s),
        equivalent_lag_s(steer),
        value_of(slowest.dead_time_s),
        equivalent_lag_s(slowest),
        ticks * bench.dt_s,
    )
    return Identified(map_of_plant(model, vehicle), delays)


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
