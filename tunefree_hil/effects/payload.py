"""A payload: a point mass on the centre line."""

from __future__ import annotations

from collections.abc import Callable

from tunefree_hil.base.contracts import BodyChange, Effect, Need, Port, Prior


def make(params: dict[str, float], rest: float) -> Callable[[BodyChange], BodyChange]:
    """Adds mass_kg (negative removes mass), ahead_m ahead of the unladen centre of mass."""
    mass_kg, ahead_m = params["mass_kg"], params["ahead_m"]

    def load(change: BodyChange) -> BodyChange:
        return change._replace(
            payload_kg=change.payload_kg + mass_kg,
            payload_moment_kgm=change.payload_moment_kgm + mass_kg * ahead_m,
            payload_inertia_kgm2=change.payload_inertia_kgm2 + mass_kg * ahead_m * ahead_m,
        )

    return load


EFFECT = Effect(
    Port.BODY,
    {"mass_kg": 0.0, "ahead_m": 0.0},
    {"mass_kg": "kg", "ahead_m": "m"},
    make,
    "drive and brake give less acceleration, in the same proportion; understeer shifts when the load is off the middle",
    priors={
        "mass_kg": Prior(-0.2, 0.6, 0.15, "linear", "mass_kg"),
        "ahead_m": Prior(-0.5, 0.5, -0.2, "linear", "wheelbase_m"),
    },
    impostors=("throttle_gain", "brake_gain", "front_stiffness", "rear_stiffness", "aero_drag", "brake_drag"),
    manoeuvre=(
        "throttle steps and brake steps of the same size: "
        "both give less in the same proportion; coasting hardly changes"
    ),
    needs=(Need("throttle_span_frac", 0.15), Need("brake_span_frac", 0.08), Need("brakings", 3.0)),
)
