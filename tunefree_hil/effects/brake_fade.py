"""Brake fade: the gain falls with the dissipated energy (no cooling, not below 0.3)."""

from __future__ import annotations

from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Need, Port, Prior
from tunefree_hil.effects._signals import positive


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Reduces the brakes' gain by loss_per_mj for each MJ dissipated since the start."""
    loss_per_mj = positive("loss_per_mj", params["loss_per_mj"])

    def fade(change: BodyChange) -> BodyChange:
        return change._replace(brake_loss_per_mj=change.brake_loss_per_mj + loss_per_mj)

    return fade


EFFECT = Effect(
    Port.BRAKE_B,
    {"loss_per_mj": 0.0},
    {"loss_per_mj": "1/MJ"},
    make,
    "braking is as it should be at first and weaker after many stops",
    priors={"loss_per_mj": Prior(0.02, 3.0, 0.3, "log")},
    impostors=("brake_gain", "brake_dead_band"),
    manoeuvre="eight equal stops one after the other: each is weaker than the one before",
    needs=(Need("brakings", 6.0), Need("top_speed_mps", 10.0)),
)
