"""Dead time in the throttle actuator: the reported duty follows its command later."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import dead_time


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the throttle duty; delay_s [s] is added to the actuator's own."""
    return dead_time(params["delay_s"], rest)


EFFECT = Effect(
    Port.THROTTLE_A,
    {"delay_s": 0.0},
    {"delay_s": "s"},
    make,
    "reported throttle follows its command later, its shape kept",
    priors={"delay_s": Prior(0.01, 0.8, 0.15)},
    impostors=("throttle_lag", "throttle_rate_limit", "powertrain_lag", "report_latency"),
    manoeuvre="steps of the throttle, small and large: a shift keeps the shape, and other reports are in time",
    needs=(Need("throttle_moves", 6.0),),
)
