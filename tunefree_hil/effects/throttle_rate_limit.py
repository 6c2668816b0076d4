"""A throttle actuator with a rate limit."""

from __future__ import annotations

import math

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import rate_limit


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the throttle duty: after the actuator's lag: at most rate_per_s [1/s], an absolute limit."""
    return rate_limit("rate_per_s", params["rate_per_s"], rest)


EFFECT = Effect(
    Port.THROTTLE_OUT,
    {"rate_per_s": math.inf},
    {"rate_per_s": "1/s"},
    make,
    "reported throttle climbs as a ramp on large steps, and as before on small ones",
    priors={"rate_per_s": Prior(0.05, 3.0, 0.5, "log")},
    impostors=("throttle_dead_time", "throttle_lag"),
    manoeuvre="steps of the throttle of growing size: the time that they take grows with them",
    needs=(Need("throttle_moves", 4.0), Need("throttle_span_frac", 0.2)),
)
