"""A banked road: lateral gravity, which the accelerometer measures."""

from __future__ import annotations

import math
from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Link, Need, Port, Prior
from tunefree_hil.effects._signals import finite


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Adds bank_rad, left side up: a force to the right."""
    bank_rad = finite("bank_rad", params["bank_rad"], 0.5 * math.pi)

    def tilt(change: BodyChange) -> BodyChange:
        return change._replace(bank_rad=change.bank_rad + bank_rad)

    return tilt


EFFECT = Effect(
    Port.BODY,
    {"bank_rad": 0.0},
    {"bank_rad": "rad"},
    make,
    "the car drifts to the low side with the wheel straight; lateral specific force is off, at a stand too",
    priors={"bank_rad": Prior(-0.12, 0.12, 0.02)},
    impostors=("side_wind", "steer_offset"),
    manoeuvre="straight on at two speeds, and standing: the lateral accelerometer says g sin(bank) of all that",
    needs=(Need("straight_s", 20.0), Need("moving_s", 40.0)),
    links=(Link.REPORT_TO_MOTION, Link.ACCEL_VS_DVDT),
)
