"""A slower steering motor: the rate of the reported angle is limited."""

from __future__ import annotations

import math

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import rate_limit


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle [rad]: after the motor's lag: at most rate_radps, an absolute limit."""
    return rate_limit("rate_radps", params["rate_radps"], rest)


EFFECT = Effect(
    Port.STEER_OUT,
    {"rate_radps": math.inf},
    {"rate_radps": "rad/s"},
    make,
    "reported steering climbs as a ramp on large steps, and as before on small ones",
    priors={"rate_radps": Prior(0.04, 1.2, 0.35, "log", "steer_rad")},
    impostors=("steer_dead_time", "steer_lag", "steer_saturation"),
    manoeuvre="steps of the steering of growing size: the time that they take grows with them",
    needs=(Need("steer_moves", 4.0), Need("steer_span_frac", 0.3)),
)
