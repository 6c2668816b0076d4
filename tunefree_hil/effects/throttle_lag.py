"""Lag in the throttle actuator: the reported duty follows its command more slowly."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import lag


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the throttle duty; a first-order lag of tau_s [s] before the actuator's own."""
    return lag(params["tau_s"], rest)


EFFECT = Effect(
    Port.THROTTLE_A,
    {"tau_s": 0.0},
    {"tau_s": "s"},
    make,
    "reported throttle follows its command more softly, small and quick movements most",
    priors={"tau_s": Prior(0.02, 1.0, 0.2, "log")},
    impostors=("throttle_dead_time", "throttle_rate_limit", "powertrain_lag"),
    manoeuvre="steps of the throttle, small and large: the report is soft in the same proportion on both",
    needs=(Need("throttle_moves", 6.0),),
)
