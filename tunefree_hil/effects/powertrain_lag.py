"""Lag between the reported throttle and the drive force."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import soft


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the throttle duty; a first-order lag of tau_s [s]."""
    return soft(params["tau_s"], rest)


EFFECT = Effect(
    Port.THROTTLE_B,
    {"tau_s": 0.0},
    {"tau_s": "s"},
    make,
    "acceleration follows the reported throttle more softly",
    priors={"tau_s": Prior(0.03, 1.5, 0.3, "log")},
    impostors=("throttle_dead_time", "throttle_lag", "ins_latency"),
    manoeuvre="steps of the throttle at one speed: the report is in time, the push is not, and braking is",
    needs=(Need("throttle_moves", 8.0),),
)
