"""Lag in the steering actuator: the reported angle follows its command more slowly."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import lag


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle [rad]; a first-order lag of tau_s [s] before the actuator's own."""
    return lag(params["tau_s"], rest)


EFFECT = Effect(
    Port.STEER_A,
    {"tau_s": 0.0},
    {"tau_s": "s"},
    make,
    "reported steering follows its command more softly, small and quick movements most",
    priors={"tau_s": Prior(0.01, 0.6, 0.1, "log")},
    impostors=("steer_dead_time", "steer_rate_limit", "steer_friction"),
    manoeuvre=(
        "steps of the steering, small and large, and a chirp of 0.2-3 Hz: "
        "a lag begins at once, the same share of any step"
    ),
    needs=(Need("steer_moves", 6.0),),
)
