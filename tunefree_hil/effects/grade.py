"""A slope that is not in the scenario."""

from __future__ import annotations

import math
from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Link, Need, Port, Prior
from tunefree_hil.effects._signals import finite


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Adds grade_rad (up positive) to the road's."""
    grade_rad = finite("grade_rad", params["grade_rad"], 0.5 * math.pi)

    def tilt(change: BodyChange) -> BodyChange:
        return change._replace(grade_rad=change.grade_rad + grade_rad)

    return tilt


EFFECT = Effect(
    Port.BODY,
    {"grade_rad": 0.0},
    {"grade_rad": "rad"},
    make,
    "speed changes by a constant too much or too little whatever the pedals; specific force differs from dv/dt",
    priors={"grade_rad": Prior(-0.12, 0.12, 0.02)},
    impostors=("brake_drag", "rolling_resistance", "head_wind", "accel_bias"),
    manoeuvre=(
        "coasting from two speeds, and standing: "
        "the same at every speed, and the accelerometer says g sin(grade) more than that"
    ),
    needs=(Need("moving_s", 30.0),),
    links=(Link.REPORT_TO_MOTION, Link.ACCEL_VS_DVDT),
)
