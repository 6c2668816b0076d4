"""Writes a fitted steering map as steering_map.toml (config/learned/steering_map_schema.py), and says it in a line."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

from tunefree_hil.config.dump import to_toml
from tunefree_hil.config.learned.steering_map_schema import STEERING_MAP_SCHEMA
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.estimate import Estimate
from tunefree_hil.learn.steering_map.fit import SteeringFit

HEADER = "# Written by tunefree_hil: steady wheel angle over speed and curvature (control/steering_map.py).\n"
NAMES = {  # in texts: name, unit
    "steer_ratio": ("ratio", ""),
    "offset_rad": ("offset", " rad"),
    "dead_zone_rad": ("dead zone", " rad"),
    "length_cubic_m3": ("cubic of the geometry", " m3"),
    "understeer_s2pm": ("understeer", " s2/m"),
    "understeer_cubic_s6pm3": ("cubic of the tyres", " s6/m3"),
    "rear_slip_s2pm": ("rear slip", " s2/m"),
}


class SteeringSource(Enum):
    """What a map was learned from; the value is the word in the file."""

    LOGS = "logs"
    MODEL = "model"


def write_steering_map(
    path: Path, fit: SteeringFit, vehicle: VehicleSpec, source: SteeringSource, hashes: Mapping[str, str]
) -> Path:
    """Write the file, whole or not at all.

    Args:
        hashes: 'sha256:...' of each log, or of the model, by name.
    """
    steering, covered = fit.steering, fit.coverage
    data = {
        "schema": STEERING_MAP_SCHEMA,
        "vehicle": vehicle.name,
        "vehicle_hash": f"sha256:{vehicle.hash}",
        "samples": len(fit.samples.block),
        "blocks": fit.n_blocks,
        "residual_rad": fit.residual_rad,
        "curvature_bound_1pm": steering.curvature_bound_1pm,
        "lateral_accel_bound_mps2": steering.lateral_accel_bound_mps2,
        "notes": describe_assumed(fit),
        "source": {"kind": source.value, "hashes": dict(hashes)},
        "covered": {
            "speed_mps": [covered.speed_low_mps, covered.speed_high_mps],
            "curvature_1pm": covered.curvature_1pm,
            "lateral_accel_mps2": covered.lateral_accel_mps2,
        },
        "coefficients": {name: _coefficient(estimate) for name, estimate in fit.estimates.items()},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"part-{os.getpid()}-{path.name}")
    part.write_text(HEADER + to_toml(data), encoding="utf-8")
    os.replace(part, path)
    return path


def hashes_of_drives(drives: Sequence[Drive]) -> dict[str, str]:
    """Name -> hash of the log. A name that comes twice has its number behind it."""
    hashes: dict[str, str] = {}
    for number, drive in enumerate(drives):
        name = drive.name if drive.name not in hashes else f"{drive.name} ({number})"
        hashes[name] = drive.log_hash
    return hashes


def describe_fit(fit: SteeringFit) -> str:
    """The fitted coefficients with their intervals."""
    return ", ".join(
        f"{NAMES[name][0]} {estimate.value:.3g}{NAMES[name][1]} ({estimate.low:.3g} to {estimate.high:.3g})"
        for name, estimate in fit.estimates.items()
        if estimate.known
    )


def describe_assumed(fit: SteeringFit) -> list[str]:
    """A line for each coefficient that the data could not tell. What is geometry by choice is none of them."""
    return [
        f"{NAMES[name][0]}: {estimate.why}"
        for name, estimate in fit.estimates.items()
        if not estimate.known and name in NAMES
    ]


def _coefficient(estimate: Estimate) -> dict[str, Any]:
    if estimate.known:
        return {"value": estimate.value, "low": estimate.low, "high": estimate.high}
    return {"value": estimate.value, "assumed": estimate.why}
