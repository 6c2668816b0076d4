"""Inputs of the baseline `rule_based` from a bench: data sheet, and what was identified of the vehicle."""

from __future__ import annotations

from tunefree_hil.bench import Bench, model_of
from tunefree_hil.bench.controller import constants_of, settings_of
from tunefree_hil.bench.identified import equivalent_lag_s, steering_of
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, VehicleSpec, value_of
from tunefree_hil.config.vehicle_schema import LatencySpec
from tunefree_hil.control.contract import RISE_PER_TAU
from tunefree_hil.control.filters import butterworth_delay_s
from tunefree_hil.control.steering_map import stiffness_of
from tunefree_hil.roads.limits import road_limits
from tunefree_hil.tune.baselines import RuleInputs
from tunefree_hil.tune.loop_margins import LateralLoop


def lateral_loop(bench: Bench) -> LateralLoop:
    """The lateral loop: the LQR by the data sheet, the plant with the axles of the steering map."""
    model, vehicle = model_of(bench, bench.spec.model), constants_of(bench.vehicle)
    front, rear = stiffness_of(steering_of(bench, model, vehicle), vehicle)
    steer = _actuator(bench.vehicle, model, "steer")
    ticks = model.timing.report_ticks + model.timing.command_ticks + 0.5  # and half a tick: the command is held
    filter_s = butterworth_delay_s(settings_of(bench).cutoff_hz)
    return LateralLoop(
        controller=vehicle,
        plant=vehicle._replace(front_stiffness_n_per_rad=front, rear_stiffness_n_per_rad=rear),
        dead_time_s=value_of(steer.dead_time_s) + ticks * bench.dt_s + filter_s,
        lag_s=equivalent_lag_s(steer),
        top_speed_mps=road_limits(bench.vehicle).speed_mps,
        dt_s=bench.dt_s,
    )


def rule_inputs(bench: Bench) -> RuleInputs:
    """The numbers of the vehicle: data sheet, actuators of the model, speeds of the scenarios."""
    model = model_of(bench, bench.spec.model)
    vehicle = bench.vehicle
    actuators = {name: _actuator(bench.vehicle, model, name) for name in ("throttle", "brake", "steer")}
    slower = max(actuators["throttle"], actuators["brake"], key=_delay_s)
    top_speed_mps = max(max(scenario.speed.value) for scenario in bench.scenarios.values())
    return RuleInputs(
        steer_lag_s=equivalent_lag_s(actuators["steer"]),
        drive_dead_time_s=value_of(slower.dead_time_s),
        drive_lag_s=equivalent_lag_s(slower),
        loop_delay_s=(model.timing.report_ticks + model.timing.command_ticks) * bench.dt_s,
        steer_limit_rad=vehicle.limits.steer_rad,
        steer_ratio=vehicle.nominal.steer_ratio or 1.0,
        wheelbase_m=vehicle.nominal.wheelbase_m or 1.0,
        lateral_accel_mps2=vehicle.limits.lateral_accel_mps2,
        speed_mps=top_speed_mps,
    )


def _actuator(vehicle: VehicleSpec, model: ModelSpec, channel: str) -> ActuatorSpec:
    """The actuator of a channel from the model folder, or from the data sheet where the model does not list it."""
    if channel in model.actuators:
        return model.actuators[channel]
    latency = vehicle.latency.get(channel, LatencySpec())
    return ActuatorSpec(dead_time_s=latency.dead_time_s, lag_s=latency.rise_time_s / RISE_PER_TAU)


def _delay_s(spec: ActuatorSpec) -> float:
    return value_of(spec.dead_time_s) + equivalent_lag_s(spec)
