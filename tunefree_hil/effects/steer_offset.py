"""A steering linkage that is off centre behind the report."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Port
from tunefree_hil.effects._signals import offset


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle [rad]: offset_rad on top."""
    return offset("offset_rad", params["offset_rad"])


EFFECT = Effect(
    Port.STEER_B,
    {"offset_rad": 0.0},
    {"offset_rad": "rad"},
    make,
    "the car turns by a constant curvature with the wheel reported straight",
)
