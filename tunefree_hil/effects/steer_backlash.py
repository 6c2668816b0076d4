"""Backlash between the reported steering angle and the wheels."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import play


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle [rad]: backlash with a total width of width_rad."""
    return play("width_rad", 0.5 * params["width_rad"], rest)


EFFECT = Effect(
    Port.STEER_B,
    {"width_rad": 0.0},
    {"width_rad": "rad"},
    make,
    "the car goes on turning as it did for a while after each reversal of the reported steering",
    priors={"width_rad": Prior(0.001, 0.08, 0.012, "log", "steer_rad")},
    impostors=("steer_friction", "steer_dead_band", "tyre_relaxation"),
    manoeuvre=(
        "a small sine of the steering about straight ahead, then about an offset: "
        "yaw rate waits at every reversal, the report does not"
    ),
    needs=(Need("steer_reversals", 8.0), Need("moving_s", 30.0)),
)
