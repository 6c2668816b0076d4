"""Lag between the reported brake duty and the pressure at the wheels."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import soft


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the brake duty; a first-order lag of tau_s [s]."""
    return soft(params["tau_s"], rest)


EFFECT = Effect(
    Port.BRAKE_B,
    {"tau_s": 0.0},
    {"tau_s": "s"},
    make,
    "deceleration follows the reported brake more softly",
    priors={"tau_s": Prior(0.02, 1.0, 0.25, "log")},
    impostors=("brake_dead_time", "brake_lag"),
    manoeuvre="steps of the brake at one speed: the report is in time, the deceleration is not",
    needs=(Need("brake_moves", 6.0), Need("brakings", 4.0)),
)
