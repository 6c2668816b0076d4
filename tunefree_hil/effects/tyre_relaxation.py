"""Relaxing tyres: the side force lags the slip by length over speed."""

from __future__ import annotations

from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import positive


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Adds length_m to the relaxation length of both axles."""
    length_m = positive("length_m", params["length_m"])

    def soften(change: BodyChange) -> BodyChange:
        return change._replace(relaxation_m=change.relaxation_m + length_m)

    return soften


EFFECT = Effect(
    Port.BODY,
    {"length_m": 0.0},
    {"length_m": "m"},
    make,
    "the car follows the reported steering later, the more so the slower it is",
    priors={"length_m": Prior(0.03, 1.2, 0.25, "log", "wheelbase_m")},
    impostors=("yaw_rate_filter", "steer_backlash", "front_stiffness"),
    manoeuvre=(
        "the same steps of the steering at two speeds: the lag is that of a way and not of a time, and the INS shows it"
    ),
    needs=(Need("steer_moves", 6.0), Need("speed_span_mps", 4.0)),
)
