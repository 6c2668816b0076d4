"""Less (or more) friction between tyre and road than in the model, as a factor on the scenario's."""

from __future__ import annotations

from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import positive


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Multiplies the friction by friction_frac."""
    friction_frac = positive("friction_frac", params["friction_frac"], zero=False)

    def slip(change: BodyChange) -> BodyChange:
        return change._replace(friction_frac=change.friction_frac * friction_frac)

    return slip


EFFECT = Effect(
    Port.BODY,
    {"friction_frac": 1.0},
    {"friction_frac": "1"},
    make,
    "the car turns or brakes less than asked once it is asked for much, and as before while it is not",
    priors={"friction_frac": Prior(0.15, 1.2, 0.5, "log")},
    impostors=("front_stiffness", "rear_stiffness"),
    manoeuvre="circles of growing speed, and a firm stop: gentle driving is as it should be",
    needs=(Need("lateral_accel_mps2", 3.0),),
)
