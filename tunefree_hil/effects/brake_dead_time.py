"""Dead time in the brake actuator: the reported duty follows its command later."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import dead_time


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the brake duty; delay_s [s] is added to the actuator's own."""
    return dead_time(params["delay_s"], rest)


EFFECT = Effect(
    Port.BRAKE_A,
    {"delay_s": 0.0},
    {"delay_s": "s"},
    make,
    "reported brake follows its command later, its shape kept",
    priors={"delay_s": Prior(0.01, 0.8, 0.15)},
    impostors=("brake_lag", "brake_pressure_lag", "report_latency"),
    manoeuvre="steps of the brake, light and firm: a shift keeps the shape, and other reports are in time",
    needs=(Need("brake_moves", 6.0),),
)
