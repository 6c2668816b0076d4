"""card.json of a learned plant: what it was made of, how, and how good it is where it has not learned."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from importlib import metadata
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil import __version__
from tunefree_hil.learn.drives import Drive
from tunefree_hil.learn.free_run import Judged
from tunefree_hil.learn.free_run_table import reduction, table_of

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec

SCHEMA = "tunefree.card/1"
LIBRARIES = ("numpy", "scipy", "torch")


class Training(NamedTuple):
    """How a training went; settings: what decided it. looks: (step, held-out error) pairs."""

    settings: Mapping[str, Any]
    score_words: str
    score: float
    untrained: float
    steps: int
    seconds: float
    looks: Sequence[tuple[int, float]]
    stopped: str


def card_of(
    kind: str,
    vehicle: VehicleSpec,
    physics: ModelSpec,
    drives: Sequence[Drive],
    split: str,
    seed: int,
    seconds: float,
    training: Training | None,
    judged: Mapping[str, Judged],
) -> dict[str, Any]:
    """Plain data. judged: free run on held-out stretches of 'physics' and of this kind (either may lack).

    The held-out drives have also chosen when to stop; drives that nobody has seen judge harder (tools/measure freerun).
    """
    return {
        "schema": SCHEMA,
        "kind": kind,
        "vehicle": vehicle.name,
        "vehicle_hash": f"sha256:{vehicle.hash}",
        "physics_hash": f"sha256:{physics.hash}",
        "logs": [{"name": one.name, "hash": one.log_hash, "seconds": one.ticks * one.dt_s} for one in drives],
        "seed": seed,
        "split": split,
        "versions": versions(),
        "seconds": round(seconds, 1),
        "training": training._asdict() if training else None,
        "free_run": {name: table_of(one) for name, one in judged.items()},
        "reduction_percent": _reductions(judged, kind),
    }


def versions() -> dict[str, str]:
    """Of what made the numbers; torch only where it is installed."""
    found = {"tunefree_hil": __version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _reductions(judged: Mapping[str, Judged], kind: str) -> dict[str, Any]:
    """By horizon: by how much the position error on level ground is below the physics'."""
    if not {"physics", kind} <= set(judged) or kind == "physics":
        return {}
    ours, other = judged[kind], judged["physics"]
    return {
        f"{seconds:g}": reduction(ours, other, seconds)
        for column, seconds in enumerate(ours.horizons_s)
        if _comparable(ours, other, column)
    }


def _comparable(ours: Judged, other: Judged, column: int) -> bool:
    import numpy as np

    return bool((np.isfinite(ours.position_m[:, column] + other.position_m[:, column]) & ~ours.hill).any())
