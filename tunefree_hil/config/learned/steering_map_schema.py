"""steering_map.toml (docs/reference/files.md): coefficients of a learned steering map, and what it was learned from."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Literal

from msgspec import field
from msgspec.structs import fields, replace

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.convert import convert, read_toml
from tunefree_hil.config.problem import ConfigProblem, Problems
from tunefree_hil.config.vehicle_schema import Spec

STEERING_MAP_FILE = "steering_map.toml"
STEERING_MAP_SCHEMA = "tunefree.steering_map/1"


class SteeringCoefficientSpec(Spec, frozen=True, kw_only=True):
    """A fitted coefficient has `low` and `high`, an assumed one says why it is assumed."""

    value: float
    low: float | None = None
    high: float | None = None
    assumed: str = ""


class SteeringCoefficientsSpec(Spec, frozen=True, kw_only=True):
    """The coefficients of control/steering_map.py."""

    steer_ratio: SteeringCoefficientSpec
    offset_rad: SteeringCoefficientSpec
    dead_zone_rad: SteeringCoefficientSpec
    length_m: SteeringCoefficientSpec
    length_cubic_m3: SteeringCoefficientSpec
    understeer_s2pm: SteeringCoefficientSpec
    understeer_cubic_s6pm3: SteeringCoefficientSpec
    rear_axle_m: SteeringCoefficientSpec
    rear_slip_s2pm: SteeringCoefficientSpec


class SteeringSourceSpec(Spec, frozen=True, kw_only=True):
    """What the map was learned from: the bytes of logs, or a model that was driven in steady turns."""

    kind: Literal["logs", "model"]
    hashes: dict[str, str]


class SteeringCoverageSpec(Spec, frozen=True, kw_only=True):
    """What was driven: the greatest values that the samples reach, and the range of speed."""

    speed_mps: list[float]
    curvature_1pm: float
    lateral_accel_mps2: float


class SteeringMapSpec(Spec, frozen=True, kw_only=True):
    """steering_map.toml. `path` and `hash` (hex SHA-256 of the file's bytes) are set by the loader."""

    schema: Literal["tunefree.steering_map/1"]
    vehicle: str
    vehicle_hash: str = ""
    source: SteeringSourceSpec
    samples: int
    blocks: int
    residual_rad: float
    covered: SteeringCoverageSpec
    curvature_bound_1pm: float
    lateral_accel_bound_mps2: float
    coefficients: SteeringCoefficientsSpec
    notes: list[str] = field(default_factory=list)
    path: str = ""
    hash: str = ""


def load_steering_map(path: Path) -> SteeringMapSpec:
    """A steering_map.toml. Raises InputError for a file that is not there, not TOML, or does not fit."""
    if not path.is_file():
        hint = "learn one: `tunefree-hil map LOG... --out FOLDER`, or leave controller.steering_map out"
        raise InputError("there is no such steering map", code="no_steering_map", file=str(path), hint=hint)
    spec = convert(read_toml(path), SteeringMapSpec, path)
    for problem in check_steering_map(spec):
        raise InputError(problem.message, code="bad_steering_map", file=str(path), key=problem.key, hint=problem.hint)
    return replace(spec, path=str(path), hash=hashlib.sha256(path.read_bytes()).hexdigest())


def check_steering_map(spec: SteeringMapSpec) -> Problems:
    """Intervals contain their values, and no number is one that a vehicle cannot have."""
    for name in (item.name for item in fields(spec.coefficients)):
        yield from _coefficient(f"coefficients.{name}", getattr(spec.coefficients, name))
    for name in ("steer_ratio", "length_m"):
        if getattr(spec.coefficients, name).value <= 0.0:
            yield ConfigProblem(f"coefficients.{name}.value", "it is not positive", "learn the map again")
    if spec.coefficients.dead_zone_rad.value < 0.0:
        yield ConfigProblem("coefficients.dead_zone_rad.value", "it is negative", "give 0 for none")
    for name in ("curvature_bound_1pm", "lateral_accel_bound_mps2"):
        if getattr(spec, name) < 0.0:
            yield ConfigProblem(name, "it is negative", "give what the data covered")


def _coefficient(key: str, coefficient: SteeringCoefficientSpec) -> Problems:
    low, high = coefficient.low, coefficient.high
    if (low is None) != (high is None):
        yield ConfigProblem(key, "it has one end of its interval only", "give `low` and `high`, or neither")
    if low is None and not coefficient.assumed:
        yield ConfigProblem(key, "it has neither an interval nor a reason", "give `low` and `high`, or `assumed`")
    if low is not None and high is not None and not low <= coefficient.value <= high:
        yield ConfigProblem(key, "its value lies outside its interval", "learn the map again")


STEERING_MAP_WORDS: dict[type[Spec], dict[str, str]] = {
    SteeringMapSpec: {
        "schema": "which kind of file this is, and of which version",
        "vehicle": "name of the vehicle folder",
        "vehicle_hash": "hash of the vehicle folder of that day",
        "source": "logs or model that the map was learned from",
        "samples": "number of samples of nearly steady driving",
        "blocks": "number of stretches with samples, by which the intervals were made",
        "residual_rad": "rad of steering wheel, RMS of measured minus map",
        "covered": "what was driven",
        "curvature_bound_1pm": "1/m, beyond which the map goes on with its slope there",
        "lateral_accel_bound_mps2": "m/s2, the same for the lateral acceleration",
        "coefficients": "the numbers of the map, each with its 95 % interval or why it is assumed",
        "notes": "what the data could not tell",
    },
    SteeringSourceSpec: {
        "kind": "logs, or model for one that was driven in steady turns",
        "hashes": "name -> SHA-256 of each log, or of the model",
    },
    SteeringCoverageSpec: {
        "speed_mps": "m/s, least and greatest speed",
        "curvature_1pm": "1/m, greatest curvature to either side",
        "lateral_accel_mps2": "m/s2, greatest lateral acceleration to either side",
    },
    SteeringCoefficientsSpec: {
        "steer_ratio": "steering-wheel angle over road-wheel angle",
        "offset_rad": "rad of steering wheel with which the vehicle drives straight on",
        "dead_zone_rad": "rad of steering wheel, half width of what does not turn the vehicle",
        "length_m": "m, road-wheel angle per curvature at standstill",
        "length_cubic_m3": "m3, its growth with curvature squared",
        "understeer_s2pm": "s2/m, road-wheel angle per lateral acceleration",
        "understeer_cubic_s6pm3": "s6/m3, its growth with lateral acceleration squared",
        "rear_axle_m": "m, centre of mass to rear axle",
        "rear_slip_s2pm": "s2/m, slip angle of the rear axle per lateral acceleration",
    },
    SteeringCoefficientSpec: {
        "value": "the number that the controller uses",
        "low": "lower end of the 95 % interval",
        "high": "upper end of the 95 % interval",
        "assumed": "why it is not fitted; '' for a fitted one",
    },
}
