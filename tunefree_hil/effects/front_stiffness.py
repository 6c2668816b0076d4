"""Tyres on the front axle that are stiffer or softer than the model's."""

from __future__ import annotations

from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import positive


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Multiplies the cornering stiffness of the front axle by gain_frac."""
    gain_frac = positive("gain_frac", params["gain_frac"], zero=False)

    def stiffen(change: BodyChange) -> BodyChange:
        return change._replace(front_stiffness_frac=change.front_stiffness_frac * gain_frac)

    return stiffen


EFFECT = Effect(
    Port.BODY,
    {"gain_frac": 1.0},
    {"gain_frac": "1"},
    make,
    "the car turns by a factor other than the reported steering says, which depends on speed",
    priors={"gain_frac": Prior(0.5, 2.0, 0.8, "log")},
    impostors=("rear_stiffness", "steer_gain", "payload", "friction", "tyre_relaxation"),
    manoeuvre=(
        "circles at three speeds: nothing at walking pace, more with speed; steps of the steering tell the axles apart"
    ),
    needs=(Need("curve_s", 10.0), Need("top_speed_mps", 8.0), Need("lateral_accel_mps2", 1.5)),
)
