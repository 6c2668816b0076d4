"""A brake that rubs: a force against the motion whatever the pedals say."""

from __future__ import annotations

from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Port
from tunefree_hil.effects._signals import positive


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Adds force_n against the motion."""
    force_n = positive("force_n", params["force_n"])

    def rub(change: BodyChange) -> BodyChange:
        return change._replace(brake_drag_n=change.brake_drag_n + force_n)

    return rub


EFFECT = Effect(
    Port.BRAKE_B,
    {"force_n": 0.0},
    {"force_n": "N"},
    make,
    "the car rolls out sooner, by the same deceleration at every speed",
)
