"""Bias of the longitudinal accelerometer."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Link, Need, Port, Prior
from tunefree_hil.effects._reports import on_accel
from tunefree_hil.effects._signals import offset


def make(params: dict[str, float], rest: float) -> Block:
    """Block on Report: bias_mps2 added to the longitudinal acceleration."""
    return on_accel(offset("bias_mps2", params["bias_mps2"]))


EFFECT = Effect(
    Port.REPORT,
    {"bias_mps2": 0.0},
    {"bias_mps2": "m/s2"},
    make,
    "reported acceleration differs from the rate of speed by a constant that the motion does not feel",
    priors={"bias_mps2": Prior(-0.8, 0.8, 0.15)},
    impostors=("grade",),
    manoeuvre="standing and coasting: the accelerometer says a constant too much, and the car rolls as on the level",
    needs=(Need("moving_s", 10.0),),
    links=(Link.ACCEL_VS_DVDT,),
)
