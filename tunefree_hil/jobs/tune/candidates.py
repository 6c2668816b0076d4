"""The tuned parameter vector, and those that it is held against (interfaces 7), complete and in binary32."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, model_of, own_parameters, parameters_of
from tunefree_hil.config.convert import read_toml
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, VehicleSpec, value_of
from tunefree_hil.config.vehicle_schema import LatencySpec
from tunefree_hil.control.inner.mrac import RISE_PER_TAU
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.tune.baselines import RuleInputs, lag_of_order_2_s, manual_vectors, opening, rule_based

TUNED = "tuned"
GIVEN = "given"  # the bench file's own values for somebody else's controller: nobody knows manual gains for that


def best_of(run: RunFolder) -> dict[str, Any]:
    """best.toml of a tune. Raises InputError where the study is not finished, or the file was changed."""
    path = run.path / "best.toml"
    if not path.is_file():
        hint = "run the same tune command again"
        raise InputError("has no best.toml: the study is not finished", file=str(run.path), hint=hint)
    best = read_toml(path)
    if not isinstance(best.get("parameters"), dict):
        hint = "the same tune command, with --resume RUN, writes it anew"
        raise InputError("is not there", code="bad_toml", file=str(path), key="parameters", hint=hint)
    return best


def winner_of(bench: Bench, run: RunFolder) -> dict[str, float]:
    """The vector that a tune found."""
    return parameters_of(bench, best_of(run)["parameters"])


def baseline_vectors(bench: Bench) -> dict[str, dict[str, float]]:
    """The vehicle's manual baselines by name; `rule_based` is worked out from data sheet and the model's actuators.

    Where the bench file names parameters of somebody else's controller there is one: the values that it gives.
    """
    if own_parameters(bench):
        return {GIVEN: parameters_of(bench)}
    shipped = bench.vehicle.manual_gains == "as_shipped"
    vectors = manual_vectors(rule_based(_rule_inputs(bench)), shipped=shipped)
    return {name: parameters_of(bench, values) for name, values in vectors.items()}


def opening_of(vectors: Mapping[str, Mapping[str, float]]) -> Mapping[str, float]:
    """Which of the baselines opens a study."""
    return vectors[GIVEN] if GIVEN in vectors else opening(vectors)


def _rule_inputs(bench: Bench) -> RuleInputs:
    model = model_of(bench, bench.spec.model)
    vehicle = bench.vehicle
    actuators = {name: _actuator(bench.vehicle, model, name) for name in ("throttle", "brake", "steer")}
    slow = max(actuators["throttle"], actuators["brake"], key=_delay_s)
    fastest = max(max(scenario.speed.value) for scenario in bench.scenarios.values())
    return RuleInputs(
        steer_lag_s=_lag_s(actuators["steer"]),
        drive_dead_time_s=value_of(slow.dead_time_s),
        drive_lag_s=_lag_s(slow),
        loop_delay_s=(model.timing.report_ticks + model.timing.command_ticks) * bench.dt_s,
        steer_limit_rad=vehicle.limits.steer_rad,
        steer_ratio=vehicle.nominal.steer_ratio or 1.0,
        wheelbase_m=vehicle.nominal.wheelbase_m or 1.0,
        lateral_accel_mps2=vehicle.limits.lateral_accel_mps2,
        speed_mps=fastest,
    )


def _actuator(vehicle: VehicleSpec, model: ModelSpec, channel: str) -> ActuatorSpec:
    """A channel as the model folder has it, as the data sheet where the model has actuators of its own."""
    if channel in model.actuators:
        return model.actuators[channel]
    latency = vehicle.latency.get(channel, LatencySpec())
    return ActuatorSpec(dead_time_s=latency.dead_time_s, lag_s=latency.rise_time_s / RISE_PER_TAU)


def _lag_s(spec: ActuatorSpec) -> float:
    if spec.order == 2:
        return lag_of_order_2_s(value_of(spec.natural_hz), value_of(spec.damping))
    return value_of(spec.lag_s)


def _delay_s(spec: ActuatorSpec) -> float:
    return value_of(spec.dead_time_s) + _lag_s(spec)
