"""A dragging brake: a force against the motion, independent of the pedals."""

from __future__ import annotations

from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Need, Port, Prior
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
    priors={"force_n": Prior(0.02, 1.5, 0.2, "log", "mass_kg")},
    impostors=("rolling_resistance", "aero_drag", "grade", "head_wind", "payload"),
    manoeuvre=(
        "coasting from high speed to a stand: "
        "the same deceleration at every speed, and the accelerometer agrees with it"
    ),
    needs=(Need("coast_s", 15.0),),
)
