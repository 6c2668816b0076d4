"""Offset of the steering sensor: in the report, not at the wheels."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Link, Need, Port, Prior
from tunefree_hil.effects._reports import on_steer
from tunefree_hil.effects._signals import offset


def make(params: dict[str, float], rest: float) -> Block:
    """Block on Report: offset_rad added to the steering-wheel angle."""
    return on_steer(offset("offset_rad", params["offset_rad"]))


EFFECT = Effect(
    Port.REPORT,
    {"offset_rad": 0.0},
    {"offset_rad": "rad"},
    make,
    "reported steering is a constant off its command, and the car turns as the command says",
    priors={"offset_rad": Prior(-0.04, 0.04, 0.006, "linear", "steer_rad")},
    impostors=("steer_offset",),
    manoeuvre="straight on, hands off: command and report differ by a constant, command and motion do not",
    needs=(Need("straight_s", 10.0),),
    links=(Link.COMMAND_TO_REPORT,),
)
