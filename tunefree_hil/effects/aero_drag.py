"""More air drag: a roof box, a trailer, open windows."""

from __future__ import annotations

from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import finite


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Adds drag_area_m2 (drag coefficient times area) in air of 1.2 kg/m3."""
    drag_area_m2 = finite("drag_area_m2", params["drag_area_m2"])

    def drag(change: BodyChange) -> BodyChange:
        return change._replace(drag_area_m2=change.drag_area_m2 + drag_area_m2)

    return drag


EFFECT = Effect(
    Port.BODY,
    {"drag_area_m2": 0.0},
    {"drag_area_m2": "m2"},
    make,
    "the car is slowed by the square of its speed, whatever the pedals",
    priors={"drag_area_m2": Prior(0.03, 3.0, 0.5, "log")},
    impostors=("head_wind", "brake_drag", "rolling_resistance", "power_limit", "payload"),
    manoeuvre=(
        "coasting from high speed to a stand: "
        "what is too much falls with the square of speed and is gone at walking pace"
    ),
    needs=(Need("coast_s", 10.0), Need("top_speed_mps", 14.0), Need("speed_span_mps", 8.0)),
)
