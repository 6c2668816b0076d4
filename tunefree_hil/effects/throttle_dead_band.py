"""A drivetrain without effect in the first part of the reported throttle."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import positive, shape


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the throttle duty: half_width_frac above rest is lost, and the output is that much less beyond."""
    return shape(rest, half_width=positive("half_width_frac", params["half_width_frac"]))


EFFECT = Effect(
    Port.THROTTLE_B,
    {"half_width_frac": 0.0},
    {"half_width_frac": "1"},
    make,
    "small throttle gives nothing, large throttle a little less than it should",
    priors={"half_width_frac": Prior(0.002, 0.15, 0.03, "log")},
    impostors=("throttle_gain", "rolling_resistance"),
    manoeuvre=(
        "steps of the throttle of growing size, and coasting: "
        "the band takes as much from each, and coasting is as it was"
    ),
    needs=(Need("throttle_moves", 4.0), Need("throttle_s", 20.0)),
)
