"""A car that is asked for an acceleration, in the pedals of the graph: the same acceleration comes out."""

from __future__ import annotations

import numpy as np
import pytest

from tests.gap.made_answer import made_model
from tunefree_hil.config.schema import ActuatorSpec, EffectSpec, ModelSpec
from tunefree_hil.gap.model.graph import channel_spec_from_model, has_channel, load_model_effects
from tunefree_hil.learn.evaluation.motion import actuator_params
from tunefree_hil.plant.actuation.acceleration_interface import FULL_MPS2
from tunefree_hil.plant.actuation.actuators import actuator

DT_S, REST = 0.01, 0.0


def model(**actuators: ActuatorSpec) -> ModelSpec:
    made = made_model()
    return ModelSpec(
        **{**{name: getattr(made, name) for name in made.__struct_fields__}, "actuators": actuators}  # pyright: ignore
    )


def output(spec: ActuatorSpec, commands: np.ndarray) -> np.ndarray:
    block = actuator(actuator_params(spec, REST, float(commands[0])))
    state, found = block.init(block.params, DT_S), []
    for command in commands.tolist():
        state, one = block.step(block.params, state, command, DT_S)
        found.append(one)
    return np.array(found)


def test_two_pedals_are_worth_the_acceleration_that_was_asked_for() -> None:
    accel = ActuatorSpec(dead_time_s=0.07, lag_s=0.3, gain=1.1)
    asked = np.concatenate([np.zeros(50), np.full(200, 1.5), np.full(200, -2.0), np.full(100, 0.4)])
    some = model(accel=accel)
    throttle, brake = (
        output(channel_spec_from_model(some, name), np.maximum(sign * asked, 0.0) / FULL_MPS2)
        for name, sign in (("throttle", 1.0), ("brake", -1.0))
    )
    assert (throttle - brake) * FULL_MPS2 == pytest.approx(output(accel, asked), abs=1e-12)


def test_amounts_are_of_full_duty_and_an_offset_counts_once() -> None:
    some = model(accel=ActuatorSpec(rate_limit=5.0, dead_band=0.2, offset=-0.1))
    throttle, brake = channel_spec_from_model(some, "throttle"), channel_spec_from_model(some, "brake")
    assert (throttle.rate_limit, throttle.dead_band, throttle.offset) == (0.5, 0.02, -0.01)
    assert (brake.rate_limit, brake.dead_band, brake.offset) == (0.5, 0.02, 0.0)


def test_what_a_model_says_of_a_channel_itself_is_taken() -> None:
    steer = ActuatorSpec(lag_s=0.2)
    some = model(steer=steer, throttle=steer, accel=ActuatorSpec(lag_s=0.7))
    assert channel_spec_from_model(some, "steer") is steer and channel_spec_from_model(some, "throttle") is steer
    assert has_channel(some, "brake") and channel_spec_from_model(some, "brake").lag_s == 0.7
    alone = model(accel=ActuatorSpec())
    assert not has_channel(alone, "steer") and channel_spec_from_model(alone, "steer") == ActuatorSpec()
    assert not has_channel(model(), "brake") and channel_spec_from_model(model(), "brake") == ActuatorSpec()


def test_what_is_before_pedals_is_not_heard_by_a_car_that_has_none() -> None:
    made = made_model()
    effects = [EffectSpec(name="throttle_lag", params={"tau_s": 0.2}), EffectSpec(name="steer_lag", params={})]
    fields = {name: getattr(made, name) for name in made.__struct_fields__} | {"effects": effects}
    assert list(load_model_effects(ModelSpec(**fields))) == ["0 throttle_lag", "1 steer_lag"]
    assert list(load_model_effects(ModelSpec(**{**fields, "actuators": {"accel": ActuatorSpec()}}))) == ["1 steer_lag"]
