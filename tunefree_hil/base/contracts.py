"""The exports of each parts folder; the folder is the registry, the file name is the public name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import Enum
from types import MappingProxyType
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
    """Where an effect sits (docs/reference/effects.md). Scalar ports carry one float, BODY a record of the plant's
    own constants."""

    STEER_A = "steer A"  # inside the actuator: visible between command and output in the report
    STEER_B = "steer B"  # after the report: visible in motion only
    THROTTLE_A = "throttle A"
    THROTTLE_B = "throttle B"
    BRAKE_A = "brake A"
    BRAKE_B = "brake B"
    # at the actuator's output, after its dead time and lag and before the report: limits of the motor
    STEER_OUT = "steer out A"
    THROTTLE_OUT = "throttle out A"
    BRAKE_OUT = "brake out A"
    BODY = "body"
    REPORT = "report"
    INS = "ins"


LEAST_BRAKE_GAIN = 0.3  # least gain after fading (docs/reference/effects.md)


class BodyChange(NamedTuple):
    """Changes of a car by effects on body and forces, for all plants; the defaults change nothing.

    Every plant applies it to its own constants when it is built: masses and grades are added, friction is a factor.
    The payload is point masses on the car's centre line: their sum, and their first and second moments about the
    unladen centre of mass, ahead of it positive.
    """

    payload_kg: float = 0.0
    payload_moment_kgm: float = 0.0
    payload_inertia_kgm2: float = 0.0
    friction_frac: float = 1.0  # factor on the scenario's friction
    grade_rad: float = 0.0  # added to the scenario's, up positive
    power_w: float = math.inf  # the driving force is at most this over the speed
    brake_drag_n: float = 0.0  # against the motion, independent of the pedals
    brake_loss_per_mj: float = 0.0  # share of the brake gain lost per MJ dissipated since the start
    front_stiffness_frac: float = 1.0  # factors on the axles' cornering stiffness
    rear_stiffness_frac: float = 1.0
    relaxation_m: float = 0.0  # addition to the relaxation length
    rolling_extra_frac: float = 0.0  # additional rolling resistance, as a share of the car's own
    drag_area_m2: float = 0.0  # added
    head_wind_mps: float = 0.0  # against the car
    side_force_n: float = 0.0  # of wind, to the left, at the centre of mass
    bank_rad: float = 0.0  # left side up


class Latency(NamedTuple):
    """Params of a Block that delays whole frames; the vehicle delays the rest of those frames as well."""

    delay_s: float


class Prior(NamedTuple):
    """Search range of a parameter in `gap`: from low to high on that scale; typical: a usual size.

    In the parameter's unit, or in multiples of the vehicle's size `times`: "steer_rad" (its largest steering-wheel
    angle), "mass_kg" or "wheelbase_m".
    """

    low: float
    high: float
    typical: float
    scale: Literal["log", "linear"] = "linear"
    times: Literal["", "steer_rad", "mass_kg", "wheelbase_m"] = ""


class Need(NamedTuple):
    """Excitation that a drive needs for an effect to be visible: at least `least` of one of QUANTITIES."""

    quantity: str
    least: float


QUANTITIES: dict[str, str] = {
    "moving_s": "s above 2 m/s",
    "top_speed_mps": "m/s, highest speed",
    "speed_span_mps": "m/s between the highest and the lowest speed above 2 m/s",
    "straight_s": "s above 2 m/s with less than 0.3 m/s2 of lateral acceleration",
    "curve_s": "s with more than 0.5 m/s2 of lateral acceleration, the side that has less of it",
    "lateral_accel_mps2": "m/s2, highest lateral acceleration",
    "steer_moves": "changes of the commanded steering by 2 % of its limit within 0.5 s",
    "steer_reversals": "times that the commanded steering turns back by 1 % of its limit",
    "steer_span_frac": "of the limit, between the commanded steering furthest left and right",
    "throttle_moves": "changes of the commanded throttle by 0.03 within 0.5 s",
    "throttle_span_frac": "between the least and the most commanded throttle",
    "throttle_s": "s of throttle over rest",
    "brake_moves": "changes of the commanded brake by 0.03 within 0.5 s",
    "brake_span_frac": "between the least and the most commanded brake",
    "brakings": "brakings by 3 m/s or more",
    "coast_s": "s above 2 m/s with both pedals at rest",
}  # quantities of a drive, with their units


class Link(Enum):
    """The links of the chain from command to clock, each of which can be checked in a log
    (docs/reference/effects.md)."""

    COMMAND_ECHO = "command_echo"
    COMMAND_TO_REPORT = "command_to_report"
    REPORT_TO_MOTION = "report_to_motion"
    WHEEL_VS_INS = "wheel_vs_ins"
    YAW_VS_INS = "yaw_vs_ins"
    ACCEL_VS_DVDT = "accel_vs_dvdt"
    CLOCK = "clock"


class Effect(NamedTuple):
    """An effect of the catalogue (docs/reference/effects.md). With `neutral` it is the identity, bit for bit (-0.0
    equals 0.0).

    make(params, rest) -> Block on its port's value (a float; a Report or an Ins on those two ports). `rest` is the
    port's value at rest: 0 for steering, the rest duty for a pedal; effects act on value - rest and start there.
    For BODY, and for what needs the plant's own forces (power_limit, brake_fade, brake_drag), make(params, rest) ->
    (BodyChange) -> BodyChange, a plain function used when the plant is built.

    A bench needs only these; the rest is for identification from a log. symptom: its signature. priors: one a
    parameter. impostors: names of effects with a similar signature. manoeuvre: drive that separates it from them.
    needs: excitation that it needs. links: those that it changes, the main one first; by default those of the port
    (`links_of`).
    """

    port: Port
    neutral: dict[str, float]
    units: dict[str, str]
    make: Callable[..., Any]
    symptom: str
    priors: Mapping[str, Prior] = MappingProxyType({})
    impostors: tuple[str, ...] = ()
    manoeuvre: str = ""
    needs: tuple[Need, ...] = ()
    links: tuple[Link, ...] = ()


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


def place_of(effect: Effect) -> str:
    """'A' inside an actuator, before its report; 'B' after a report; '' for body, reports and INS."""
    return effect.port.value[-1] if effect.port.value.endswith((" A", " B")) else ""


def links_of(effect: Effect) -> tuple[Link, ...]:
    """The links that an effect changes, the main one first."""
    if effect.links:
        return effect.links
    return (Link.COMMAND_TO_REPORT,) if place_of(effect) == "A" else (Link.REPORT_TO_MOTION,)


def prior_of(effect: Effect, parameter: str, sizes: Mapping[str, float]) -> Prior:
    """The prior of a parameter in its own unit, for a vehicle of these sizes (keys as `Prior.times`).

    Raises InputError for an effect without a prior, and for an unknown size.
    """
    prior = effect.priors.get(parameter)
    if prior is None:
        raise InputError(
            f"no prior for {parameter}",
            code="no_prior",
            key=parameter,
            hint="give the effect's EFFECT a Prior for each parameter, or leave it out of what is looked for",
        )
    if not prior.times:
        return prior
    size = sizes.get(prior.times, 0.0)
    if not (math.isfinite(size) and size > 0.0):
        raise InputError(
            f"{parameter} is looked for in multiples of {prior.times}, which is {size}",
            code="unknown_size",
            key=prior.times,
            hint="[limits] and [nominal] of vehicle.toml say it",
        )
    return Prior(prior.low * size, prior.high * size, prior.typical * size, prior.scale)


__all__ = [
    "LEAST_BRAKE_GAIN",
    "QUANTITIES",
    "Block",
    "BodyChange",
    "Effect",
    "Latency",
    "Link",
    "Need",
    "Port",
    "Prior",
    "Tunable",
    "links_of",
    "make_effect",
    "place_of",
    "prior_of",
]
