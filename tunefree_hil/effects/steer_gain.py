"""Another steering ratio after the report: the road-wheel angle is scaled relative to the reported angle."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import gain


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle [rad]: gain_frac times it."""
    return gain("gain_frac", params["gain_frac"])


EFFECT = Effect(
    Port.STEER_B,
    {"gain_frac": 1.0},
    {"gain_frac": "1"},
    make,
    "curvature is a constant factor off what the reported steering would give, at every speed",
    priors={"gain_frac": Prior(0.6, 1.6, 0.9, "log")},
    impostors=("front_stiffness", "rear_stiffness", "yaw_rate_scale", "speed_scale"),
    manoeuvre="circles at three speeds: a gain is the same share at all, and the INS says so too",
    needs=(Need("curve_s", 10.0),),
)
