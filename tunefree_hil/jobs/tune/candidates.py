"""The tuned parameter vector and the baselines that it is compared with, complete and in binary32."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, model_of, own_parameters, parameters_of
from tunefree_hil.config.convert import read_toml
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, VehicleSpec, value_of
from tunefree_hil.config.vehicle_schema import LatencySpec
from tunefree_hil.control.inner.mrac import RISE_PER_TAU
from tunefree_hil.control.parameters import BY_NAME
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.tune.baselines import (
    RuleInputs,
    compute_rule_based,
    equivalent_lag_s,
    list_manual_vectors,
    select_first_baseline,
)

TUNED = "tuned"
BENCH_VALUES = "given"  # baseline of a foreign controller: the values of the bench file, as there are no manual gains


def read_best(run: RunFolder) -> dict[str, Any]:
    """Read best.toml of a tune. Raises InputError where the study is not finished, or the file was changed."""
    path = run.path / "best.toml"
    if not path.is_file():
        hint = "run the same tune command again"
        raise InputError("has no best.toml: the study is not finished", file=str(run.path), hint=hint)
    best = read_toml(path)
    if not isinstance(best.get("parameters"), dict):
        hint = "run the same tune command with --resume RUN to write it again"
        raise InputError("is missing", code="bad_toml", file=str(path), key="parameters", hint=hint)
    return best


def read_winner(bench: Bench, run: RunFolder) -> dict[str, float]:
    """The complete vector of the winner of a tune."""
    return parameters_of(bench, read_best(run)["parameters"])


def compute_baseline_vectors(bench: Bench) -> dict[str, dict[str, float]]:
    """The baselines of the vehicle by name; `rule_based` is computed from data sheet and actuators of the model.

    A foreign controller with parameters in the bench file has one baseline: the values of the bench file.
    """
    if own_parameters(bench):
        return {BENCH_VALUES: parameters_of(bench)}
    shipped = bench.vehicle.manual_gains == "as_shipped"
    vectors = list_manual_vectors(compute_rule_based(_rule_inputs(bench)), shipped=shipped)
    return {name: parameters_of(bench, values) for name, values in vectors.items()}


def select_first_vector(vectors: Mapping[str, Mapping[str, float]]) -> Mapping[str, float]:
    """The baseline that is the first trial of a study."""
    return vectors[BENCH_VALUES] if BENCH_VALUES in vectors else select_first_baseline(vectors)


def parameter_unit(name: str) -> str:
    """Unit of a parameter; '' for one of a foreign controller."""
    return BY_NAME[name].tunable.unit if name in BY_NAME else ""


def _rule_inputs(bench: Bench) -> RuleInputs:
    model = model_of(bench, bench.spec.model)
    vehicle = bench.vehicle
    actuators = {name: _actuator(bench.vehicle, model, name) for name in ("throttle", "brake", "steer")}
    slower = max(actuators["throttle"], actuators["brake"], key=_delay_s)
    top_speed_mps = max(max(scenario.speed.value) for scenario in bench.scenarios.values())
    return RuleInputs(
        steer_lag_s=_lag_s(actuators["steer"]),
        drive_dead_time_s=value_of(slower.dead_time_s),
        drive_lag_s=_lag_s(slower),
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


def _lag_s(spec: ActuatorSpec) -> float:
    if spec.order == 2:
        return equivalent_lag_s(value_of(spec.natural_hz), value_of(spec.damping))
    return value_of(spec.lag_s)


def _delay_s(spec: ActuatorSpec) -> float:
    return value_of(spec.dead_time_s) + _lag_s(spec)
