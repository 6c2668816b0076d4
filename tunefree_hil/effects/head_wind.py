"""Wind against the car, on its own drag area."""

from __future__ import annotations

from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import finite


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Adds wind_mps against the car (negative from behind)."""
    wind_mps = finite("wind_mps", params["wind_mps"])

    def blow(change: BodyChange) -> BodyChange:
        return change._replace(head_wind_mps=change.head_wind_mps + wind_mps)

    return blow


EFFECT = Effect(
    Port.BODY,
    {"wind_mps": 0.0},
    {"wind_mps": "m/s"},
    make,
    "the car is slowed by its speed through the air, so the more the faster it is, and a little at a stand",
    priors={"wind_mps": Prior(-20.0, 20.0, 5.0)},
    impostors=("aero_drag", "brake_drag", "grade"),
    manoeuvre=(
        "coasting from high speed to a stand: "
        "what is too much grows in proportion to speed and is not gone at walking pace"
    ),
    needs=(Need("coast_s", 10.0), Need("top_speed_mps", 14.0)),
)
