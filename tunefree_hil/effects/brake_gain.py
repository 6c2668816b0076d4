"""A brake whose force differs by a factor from that of its reported duty."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import positive, shape


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the brake duty: gain_frac times the duty above rest."""
    return shape(rest, gain=positive("gain_frac", params["gain_frac"], zero=False))


EFFECT = Effect(
    Port.BRAKE_B,
    {"gain_frac": 1.0},
    {"gain_frac": "1"},
    make,
    "braking is off by the same factor at every pressure, and does not change with time",
    priors={"gain_frac": Prior(0.4, 2.0, 0.8, "log")},
    impostors=("brake_dead_band", "brake_fade", "payload"),
    manoeuvre=(
        "braking at growing levels, and throttle: a gain is the same share at each level, and the throttle is as it was"
    ),
    needs=(Need("brakings", 4.0), Need("brake_span_frac", 0.08)),
)
