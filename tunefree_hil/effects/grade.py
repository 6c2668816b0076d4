"""A slope that the scenario does not know."""

from __future__ import annotations

import math
from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Port
from tunefree_hil.base.errors import InputError


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Adds grade_rad (up positive) to the road's."""
    grade_rad = params["grade_rad"]
    if not abs(grade_rad) < math.pi / 2.0:
        raise InputError(
            f"grade_rad = {grade_rad}", code="bad_effect_parameter", key="grade_rad", hint="between -pi/2 and pi/2"
        )

    def tilt(change: BodyChange) -> BodyChange:
        return change._replace(grade_rad=change.grade_rad + grade_rad)

    return tilt


EFFECT = Effect(
    Port.BODY,
    {"grade_rad": 0.0},
    {"grade_rad": "rad"},
    make,
    "speed changes by a constant too much or too little whatever the pedals; specific force differs from dv/dt",
)
