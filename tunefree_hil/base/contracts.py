"""What each parts folder must export (style: the folder is the registry, the file name is the public name)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any, Literal, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block


class Tunable(NamedTuple):
    """One number that a tuner may choose. `steps`/`choices` make it discrete."""

    name: str
    unit: str
    low: float
    high: float
    scale: Literal["log", "linear"] = "log"
    step: float | None = None
    choices: tuple[float, ...] | None = None


class Port(Enum):
    """Where an effect sits (interfaces 4). Scalar ports carry one float, BODY a record of the plant's own constants."""

    STEER_A = "steer A"  # inside the actuator: seen between command and output in the report
    STEER_B = "steer B"  # behind the report: seen only in motion
    THROTTLE_A = "throttle A"
    THROTTLE_B = "throttle B"
    BRAKE_A = "brake A"
    BRAKE_B = "brake B"
    BODY = "body"
    REPORT = "report"
    INS = "ins"


LEAST_BRAKE_GAIN = 0.3  # what fading leaves (interfaces 4)


class BodyChange(NamedTuple):
    """What effects on the body and on forces change of a car, whichever physics it is; the defaults change nothing.

    Every plant applies it to its own constants when it is built: masses and grades are added, friction is a factor.
    The payload is point masses on the car's centre line: their sum, and their first and second moments about the
    unladen centre of mass, ahead of it positive.
    """

    payload_kg: float = 0.0
    payload_moment_kgm: float = 0.0
    payload_inertia_kgm2: float = 0.0
    friction_frac: float = 1.0  # factor on the road's friction, whatever the scenario says it is
    grade_rad: float = 0.0  # added to the scenario's, up positive
    power_w: float = math.inf  # the driving force is at most this over the speed
    brake_drag_n: float = 0.0  # against the motion, whatever the pedals say
    brake_loss_per_mj: float = 0.0  # of the brakes' gain, for each MJ that they have dissipated since the start


class Effect(NamedTuple):
    """An effect of the catalogue (interfaces 4). With `neutral` it is the identity bit for bit (-0.0 equals 0.0).

    make(params, rest) -> Block on its port's value (a float; a Report or an Ins on those two ports). `rest` is the
    port's value at rest: 0 for steering, the rest duty for a pedal; effects act on value - rest and start there.
    For BODY, and for what needs the plant's own forces (power_limit, brake_fade, brake_drag), make(params, rest) ->
    (BodyChange) -> BodyChange, a plain function used when the plant is built.
    """

    port: Port
    neutral: dict[str, float]
    units: dict[str, str]
    make: Callable[..., Any]
    symptom: str


def make_effect(effect: Effect, params: Mapping[str, float], *, rest: float = 0.0, name: str = "effect") -> Any:
    """What `effect.make` gives for `params`; a parameter left out is neutral.

    Raises InputError for a parameter that the effect does not have.
    """
    unknown = sorted(set(params) - set(effect.neutral))
    if unknown:
        known = ", ".join(f"{key} [{effect.units[key]}]" for key in effect.neutral)
        raise InputError(
            f"{name} has no parameter {', '.join(unknown)}",
            code="unknown_effect_parameter",
            key=unknown[0],
            hint=f"it has {known}",
        )
    return effect.make({**effect.neutral, **{key: float(value) for key, value in params.items()}}, rest)


__all__ = ["LEAST_BRAKE_GAIN", "Block", "BodyChange", "Effect", "Port", "Tunable", "make_effect"]
