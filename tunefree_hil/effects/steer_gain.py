"""Another steering ratio behind the report: the car turns by a factor more or less than its reported angle says."""

from __future__ import annotations

from typing import Any

from tunefree_hil.base.contracts import Block, Effect, Port
from tunefree_hil.base.kernel import kernel
from tunefree_hil.effects._signals import positive


@kernel
def step(params: float, state: float, x: float, dt_s: float) -> tuple[float, float]:
    """The angle that the wheels feel."""
    return state, params * x


def init(params: Any, dt_s: float) -> float:
    """No memory."""
    return 0.0


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle [rad]: gain_frac times it."""
    return Block(init, step, positive("gain_frac", params["gain_frac"], zero=False))


EFFECT = Effect(
    Port.STEER_B,
    {"gain_frac": 1.0},
    {"gain_frac": "1"},
    make,
    "curvature is a constant factor off what the reported steering would give, at every speed",
)
