"""Dead time in the steering actuator: the reported angle follows its command later."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import dead_time


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle [rad]; delay_s [s] is added to the actuator's own."""
    return dead_time(params["delay_s"], rest)


EFFECT = Effect(
    Port.STEER_A,
    {"delay_s": 0.0},
    {"delay_s": "s"},
    make,
    "reported steering follows its command later, its shape kept",
    priors={"delay_s": Prior(0.01, 0.5, 0.1)},
    impostors=("steer_lag", "steer_rate_limit", "report_latency"),
    manoeuvre="steps of the steering and a chirp of 0.2-3 Hz: a shift keeps the shape, and other reports are in time",
    needs=(Need("steer_moves", 6.0),),
)
