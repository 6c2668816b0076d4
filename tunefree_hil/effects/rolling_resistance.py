"""More (or less) rolling resistance than the model has."""

from __future__ import annotations

from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Need, Port, Prior
from tunefree_hil.base.errors import InputError
from tunefree_hil.effects._signals import finite


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Adds extra_frac of the car's own rolling resistance; -1 removes all of it."""
    extra_frac = finite("extra_frac", params["extra_frac"])
    if extra_frac < -1.0:
        raise InputError(
            f"extra_frac = {extra_frac}",
            code="bad_effect_parameter",
            key="extra_frac",
            hint="-1 or more: there is no more resistance to take away",
        )

    def roll(change: BodyChange) -> BodyChange:
        return change._replace(rolling_extra_frac=change.rolling_extra_frac + extra_frac)

    return roll


EFFECT = Effect(
    Port.BODY,
    {"extra_frac": 0.0},
    {"extra_frac": "1"},
    make,
    "the car rolls out sooner or later, by the same deceleration at every speed",
    priors={"extra_frac": Prior(-0.8, 4.0, 0.5)},
    impostors=("brake_drag", "aero_drag", "grade", "throttle_dead_band"),
    manoeuvre=(
        "coasting from high speed to a stand: "
        "the same deceleration at every speed, and the accelerometer agrees with it"
    ),
    needs=(Need("coast_s", 15.0),),
)
