"""A steering actuator with a dead band: it ignores small commands near straight ahead."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import positive, shape


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle [rad]: half_width_rad on each side of straight ahead is lost."""
    return shape(rest, half_width=positive("half_width_rad", params["half_width_rad"]))


EFFECT = Effect(
    Port.STEER_A,
    {"half_width_rad": 0.0},
    {"half_width_rad": "rad"},
    make,
    "reported steering ignores small commands about straight ahead, and is short by as much beyond them",
    priors={"half_width_rad": Prior(0.0005, 0.05, 0.008, "log", "steer_rad")},
    impostors=("steer_friction", "steer_backlash"),
    manoeuvre=(
        "a small sine of the steering about straight ahead, then about an offset: the band is about straight ahead only"
    ),
    needs=(Need("steer_reversals", 6.0),),
)
