"""A brake without effect in the first part of its reported duty."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import positive, shape


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the brake duty: half_width_frac above rest is lost, and the output is that much less beyond."""
    return shape(rest, half_width=positive("half_width_frac", params["half_width_frac"]))


EFFECT = Effect(
    Port.BRAKE_B,
    {"half_width_frac": 0.0},
    {"half_width_frac": "1"},
    make,
    "light braking gives nothing, hard braking a little less than it should",
    priors={"half_width_frac": Prior(0.002, 0.1, 0.02, "log")},
    impostors=("brake_gain", "brake_fade"),
    manoeuvre="braking at levels that grow from the lightest: the band takes as much from each",
    needs=(Need("brakings", 4.0), Need("brake_span_frac", 0.08)),
)
