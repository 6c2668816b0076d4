"""A drivetrain whose force differs by a factor from that of the reported throttle."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import positive, shape


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the throttle duty: gain_frac times the duty above rest."""
    return shape(rest, gain=positive("gain_frac", params["gain_frac"], zero=False))


EFFECT = Effect(
    Port.THROTTLE_B,
    {"gain_frac": 1.0},
    {"gain_frac": "1"},
    make,
    "throttle gives as much acceleration as another duty would, by the same factor at small and medium throttle",
    priors={"gain_frac": Prior(0.5, 2.0, 0.85, "log")},
    impostors=("throttle_dead_band", "power_limit", "payload"),
    manoeuvre="steps of the throttle of growing size at low speed, then braking: the brakes are as they should be",
    needs=(Need("throttle_span_frac", 0.15), Need("throttle_s", 20.0)),
)
