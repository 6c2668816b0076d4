"""Scale error of the gyro."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Link, Need, Port, Prior
from tunefree_hil.effects._reports import on_yaw_rate
from tunefree_hil.effects._signals import gain


def make(params: dict[str, float], rest: float) -> Block:
    """Block on Report: scale_frac times the yaw rate."""
    return on_yaw_rate(gain("scale_frac", params["scale_frac"]))


EFFECT = Effect(
    Port.REPORT,
    {"scale_frac": 1.0},
    {"scale_frac": "1"},
    make,
    "reported yaw rate is a constant factor off the INS's",
    priors={"scale_frac": Prior(0.7, 1.4, 0.95, "log")},
    impostors=("speed_scale", "steer_gain"),
    manoeuvre="circles both ways: gyro and INS differ by the same share",
    needs=(Need("curve_s", 8.0),),
    links=(Link.YAW_VS_INS,),
)
