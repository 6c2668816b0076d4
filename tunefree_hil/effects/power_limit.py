"""A drivetrain with less power: its force is capped at power over speed."""

from __future__ import annotations

import math
from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Need, Port, Prior
from tunefree_hil.base.errors import InputError


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Caps the driving force at power_w over speed, an absolute limit; of two limits the lower one is used."""
    power_w = params["power_w"]
    if not power_w > 0.0:
        raise InputError(f"power_w = {power_w}", code="bad_effect_parameter", key="power_w", hint="more than 0")

    def cap(change: BodyChange) -> BodyChange:
        return change._replace(power_w=min(change.power_w, power_w))

    return cap


EFFECT = Effect(
    Port.THROTTLE_B,
    {"power_w": math.inf},
    {"power_w": "W"},
    make,
    "acceleration at much throttle falls short the more the faster the car is, little throttle is as before",
    priors={"power_w": Prior(3.0, 60.0, 10.0, "log", "mass_kg")},
    impostors=("throttle_gain", "aero_drag"),
    manoeuvre=(
        "full throttle from a stand to high speed, then coasting: the loss grows with speed, and only on the throttle"
    ),
    needs=(Need("throttle_span_frac", 0.25), Need("top_speed_mps", 10.0)),
)
