"""[actuators] of the three channels of a graph, also of a car that has two: one that is asked for an acceleration."""

from __future__ import annotations

from tunefree_hil.base import parts
from tunefree_hil.base.contracts import Effect, Port
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, value_of
from tunefree_hil.plant.asked_accel import FULL_MPS2

ACCEL, PEDALS = "accel", ("throttle", "brake")
UNHEARD = "the car is asked for an acceleration: it has no pedal before its actuators"


def is_known(model: ModelSpec, name: str) -> bool:
    """Whether a model says anything of a channel: 'throttle', 'brake', 'steer'."""
    return name in model.actuators or (name != "steer" and ACCEL in model.actuators)


def is_by_accel(model: ModelSpec) -> bool:
    """Whether a model's car is asked for an acceleration and has no pedals of its own."""
    return ACCEL in model.actuators and not any(name in model.actuators for name in PEDALS)


def is_unheard(model: ModelSpec, port: Port) -> bool:
    """Whether an effect at a port does nothing to a model's car: what is before the pedals of one that has none."""
    return port in (Port.THROTTLE_A, Port.THROTTLE_OUT, Port.BRAKE_A, Port.BRAKE_OUT) and is_by_accel(model)


def heard(model: ModelSpec) -> dict[str, tuple[Effect, dict[str, float]]]:
    """A model's own effects that its car hears, each with its parameters, by place in the list and name."""
    loaded = [(spec, parts.load("tunefree_hil.effects", spec.name, "EFFECT")) for spec in model.effects]
    return {
        f"{i} {spec.name}": (effect, spec.params)
        for i, (spec, effect) in enumerate(loaded)
        if not is_unheard(model, effect.port)
    }


def channel_spec(model: ModelSpec, name: str) -> ActuatorSpec:
    """[actuators] of a channel; of a pedal of a car that is asked for an acceleration, its channel 'accel' in duty.

    Dead time and lag do the same to either pedal as to their difference (plant/asked_accel.py); what is an amount, in
    m/s2 there, is one of full duty here; an offset is the throttle's.
    """
    if name in model.actuators or not is_known(model, name):
        return model.actuators.get(name, ActuatorSpec())
    accel = model.actuators[ACCEL]
    amounts = {key: float(value_of(getattr(accel, key))) / FULL_MPS2 for key in ("rate_limit", "dead_band", "offset")}
    return ActuatorSpec(
        dead_time_s=accel.dead_time_s,
        order=accel.order,
        lag_s=accel.lag_s,
        natural_hz=accel.natural_hz,
        damping=accel.damping,
        rate_limit=amounts["rate_limit"],
        dead_band=amounts["dead_band"],
        gain=accel.gain,
        offset=amounts["offset"] if name == "throttle" else 0.0,
    )
