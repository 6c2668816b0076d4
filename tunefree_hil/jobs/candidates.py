"""The parameter vectors that a tuned one is held against (interfaces 7), complete and in binary32."""

from __future__ import annotations

from tunefree_hil.bench import Bench, model_of, parameters_of
from tunefree_hil.config.schema import ActuatorSpec, value_of
from tunefree_hil.control.parameters import BASELINES
from tunefree_hil.tune.baselines import RuleInputs, lag_of_order_2_s, rule_based

TUNED = "tuned"


def baseline_vectors(bench: Bench) -> dict[str, dict[str, float]]:
    """Manual baselines by name, and `rule_based` from the data sheet and the model's actuators."""
    vectors = {name: parameters_of(bench, values) for name, values in BASELINES.items()}
    vectors["rule_based"] = parameters_of(bench, rule_based(_rule_inputs(bench)))
    return vectors


def _rule_inputs(bench: Bench) -> RuleInputs:
    model = model_of(bench, bench.spec.model)
    vehicle, actuators = bench.vehicle, model.actuators
    slow = max((actuators[name] for name in ("throttle", "brake") if name in actuators), key=_delay_s)
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


def _lag_s(spec: ActuatorSpec) -> float:
    if spec.order == 2:
        return lag_of_order_2_s(value_of(spec.natural_hz), value_of(spec.damping))
    return value_of(spec.lag_s)


def _delay_s(spec: ActuatorSpec) -> float:
    return value_of(spec.dead_time_s) + _lag_s(spec)
