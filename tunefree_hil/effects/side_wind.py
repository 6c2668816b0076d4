"""A steady wind from the side: a force at the centre of mass."""

from __future__ import annotations

from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import finite


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Adds force_n to the left."""
    force_n = finite("force_n", params["force_n"])

    def blow(change: BodyChange) -> BodyChange:
        return change._replace(side_force_n=change.side_force_n + force_n)

    return blow


EFFECT = Effect(
    Port.BODY,
    {"force_n": 0.0},
    {"force_n": "N"},
    make,
    "the car drifts to one side with the wheel straight, and the lateral accelerometer hardly feels it",
    priors={"force_n": Prior(-1.0, 1.0, 0.15, "linear", "mass_kg")},
    impostors=("road_bank", "steer_offset"),
    manoeuvre="straight on at two speeds, and standing: the lateral accelerometer says nothing of it",
    needs=(Need("straight_s", 20.0), Need("moving_s", 40.0)),
)
