"""Bias of the gyro."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Link, Need, Port, Prior
from tunefree_hil.effects._reports import on_yaw_rate
from tunefree_hil.effects._signals import offset


def make(params: dict[str, float], rest: float) -> Block:
    """Block on Report: bias_radps added to the yaw rate."""
    return on_yaw_rate(offset("bias_radps", params["bias_radps"]))


EFFECT = Effect(
    Port.REPORT,
    {"bias_radps": 0.0},
    {"bias_radps": "rad/s"},
    make,
    "reported yaw rate is off by a constant, at a stand too",
    priors={"bias_radps": Prior(-0.05, 0.05, 0.01)},
    impostors=("steer_offset",),
    manoeuvre="straight on and standing: the bias is there when nothing turns, and the INS does not have it",
    needs=(Need("moving_s", 10.0),),
    links=(Link.YAW_VS_INS,),
)
