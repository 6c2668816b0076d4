"""Offset of the steering linkage after the report."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import offset


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle [rad]: offset_rad added."""
    return offset("offset_rad", params["offset_rad"])


EFFECT = Effect(
    Port.STEER_B,
    {"offset_rad": 0.0},
    {"offset_rad": "rad"},
    make,
    "the car turns by a constant curvature with the wheel reported straight",
    priors={"offset_rad": Prior(-0.04, 0.04, 0.006, "linear", "steer_rad")},
    impostors=("side_wind", "road_bank", "steer_report_offset", "yaw_rate_bias"),
    manoeuvre="straight on at two speeds: an offset gives the same curvature at both, wind and bank do not",
    needs=(Need("straight_s", 20.0), Need("moving_s", 40.0)),
)
