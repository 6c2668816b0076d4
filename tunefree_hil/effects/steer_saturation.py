"""A steering actuator with a smaller range than in its data sheet."""

from __future__ import annotations

import math

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.base.errors import InputError
from tunefree_hil.effects._signals import shape


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle [rad]: at most limit_rad to each side, an absolute limit."""
    limit_rad = params["limit_rad"]
    if not limit_rad > 0.0:
        raise InputError(
            f"limit_rad = {limit_rad}",
            code="bad_effect_parameter",
            key="limit_rad",
            hint="limit_rad must be more than 0",
        )
    return shape(rest, limit=limit_rad)


EFFECT = Effect(
    Port.STEER_A,
    {"limit_rad": math.inf},
    {"limit_rad": "rad"},
    make,
    "reported steering stops at an angle that the command passes",
    priors={"limit_rad": Prior(0.03, 1.0, 0.4, "log", "steer_rad")},
    impostors=("steer_rate_limit",),
    manoeuvre="slow steering from stop to stop, driven slowly: the report ends before the command does",
    needs=(Need("steer_span_frac", 0.5),),
)
