"""Dry friction in the steering actuator: it sticks until the command is far enough away."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import play


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle [rad]: sticks until the command is level_rad away, then follows."""
    return play("level_rad", params["level_rad"], rest)


EFFECT = Effect(
    Port.STEER_A,
    {"level_rad": 0.0},
    {"level_rad": "rad"},
    make,
    "reported steering stands still at each reversal of its command, wherever that is",
    priors={"level_rad": Prior(0.0005, 0.04, 0.006, "log", "steer_rad")},
    impostors=("steer_dead_band", "steer_backlash", "steer_lag"),
    manoeuvre=(
        "a small sine of the steering about straight ahead, then about an offset: the report stands at every reversal"
    ),
    needs=(Need("steer_reversals", 6.0),),
)
