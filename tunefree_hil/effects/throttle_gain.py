"""A drivetrain that gives a factor more or less than the reported throttle would."""

from __future__ import annotations

from tunefree_hil.base.contracts import Block, Effect, Port
from tunefree_hil.effects._signals import positive, shape


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the throttle duty: gain_frac times what is above rest."""
    return shape(rest, gain=positive("gain_frac", params["gain_frac"], zero=False))


EFFECT = Effect(
    Port.THROTTLE_B,
    {"gain_frac": 1.0},
    {"gain_frac": "1"},
    make,
    "throttle gives as much acceleration as another duty would, by the same factor at small and medium throttle",
)
