"""Schemas of the TOML files (docs/reference/files.md): frozen structs, unknown keys refused.

Only shapes and types; `check.py` and `check_vehicle.py` check that values fit together, by file and key.
"""

from __future__ import annotations

from typing import Any, Literal

from msgspec import field
from msgspec.structs import asdict, replace

from tunefree_hil.config.tuning.ensemble_schema import EnsembleSpec
from tunefree_hil.config.tuning.require_schema import RequireSpec
from tunefree_hil.config.vehicle_schema import (
    E2eSpec,
    ExtraSpec,
    FieldSpec,
    InsFrameSpec,
    LatencySpec,
    LimitsSpec,
    NominalSpec,
    OverrideSpec,
    SignalSpec,
    Spec,
    StateSpec,
    VehicleSpec,
)

__all__ = [
    "ActuatorSpec",
    "BenchSpec",
    "ControllerSpec",
    "E2eSpec",
    "EffectSpec",
    "ExtraSpec",
    "FaultSpec",
    "FieldSpec",
    "InsFrameSpec",
    "Interval",
    "LatencySpec",
    "LimitsSpec",
    "ModelSpec",
    "NominalSpec",
    "Number",
    "OverrideSpec",
    "ParameterSpec",
    "PlantSpec",
    "ProfileSpec",
    "RoadsSpec",
    "ScenarioSpec",
    "SignalSpec",
    "Spec",
    "StartSpec",
    "StateSpec",
    "TimingSpec",
    "TuneSpec",
    "ValidSpec",
    "VehicleSpec",
    "WeightsSpec",
    "field_values",
    "value_of",
    "with_controller",
    "with_scenarios",
    "with_source",
]


# --- model.toml (docs/reference/files.md) -----------------------------------------------------------------------------


class Interval(Spec, frozen=True, kw_only=True):
    """A fitted value with its interval; a bare number is allowed where no interval is known."""

    value: float
    low: float
    high: float


Number = float | Interval
DATA_SHEET_STEERING = "data_sheet"  # [controller] steering_map: the constants of eq. 3


class ActuatorSpec(Spec, frozen=True, kw_only=True):
    """Dead time, lag of order 1 (lag_s) or 2 (natural_hz, damping), rate limit, dead band, gain, offset."""

    dead_time_s: Number = 0.0
    order: Literal[1, 2] = 1
    lag_s: Number = 0.0
    natural_hz: Number = 0.0
    damping: Number = 1.0
    rate_limit: Number = float("inf")
    dead_band: Number = 0.0
    gain: Number = 1.0
    offset: Number = 0.0


class PlantSpec(Spec, frozen=True, kw_only=True):
    kind: str
    file: str = ""
    card: str = ""
    params: dict[str, float] = field(default_factory=dict)


class TimingSpec(Spec, frozen=True, kw_only=True):
    report_ticks: int = 1
    command_ticks: int = 1
    phase_seed: int = 1


class ValidSpec(Spec, frozen=True, kw_only=True):
    """The region that the data covered: [low, high] each; an absent one is not checked (episode/validity_region.py).

    pedals: duty at the actuators' outputs, rest included, the brake's negative: [-most brake, most throttle].
    steer_rad: the steering wheel, the actuator's output.
    """

    speed_mps: list[float] | None = None
    accel_mps2: list[float] | None = None
    lateral_accel_mps2: list[float] | None = None
    pedals: list[float] | None = None
    steer_rad: list[float] | None = None


class EffectSpec(Spec, frozen=True, kw_only=True):
    """An effect added by `gap`, or a perturbation of a bench file: one syntax."""

    name: str
    params: dict[str, float]
    interval: dict[str, list[float]] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)


class ModelSpec(Spec, frozen=True, kw_only=True):
    """model.toml. `folder` and `hash` are set by load_model."""

    schema: Literal["tunefree.model/1"]
    vehicle: str
    vehicle_hash: str = ""
    actuators: dict[str, ActuatorSpec] = field(default_factory=dict)
    plant: PlantSpec
    timing: TimingSpec = TimingSpec()
    noise: dict[str, float] = field(default_factory=dict)  # standard deviation by record field, 'report.speed_mps'
    bias: dict[str, float] = field(default_factory=dict)  # constant offset by record field
    valid: ValidSpec = ValidSpec()
    effects: list[EffectSpec] = field(default_factory=list)
    folder: str = ""
    hash: str = ""


# --- scenario, weights, bench (docs/reference/files.md) ---------------------------------------------------------------


class StartSpec(Spec, frozen=True, kw_only=True):
    along_m: float = 0.0  # ahead of station 0, along the path there
    lateral_m: float = 0.0
    heading_rad: float = 0.0
    speed_mps: float = 0.0


class ProfileSpec(Spec, frozen=True, kw_only=True):
    """Breakpoints, linear between them."""

    t_s: list[float]
    value: list[float]


class ScenarioSpec(Spec, frozen=True, kw_only=True):
    """One manoeuvre. `path` and `hash` (hex SHA-256 of the file's bytes) are set by load_scenario."""

    schema: Literal["tunefree.scenario/1"]
    name: str
    description: str = ""
    noise_seed: int = 1
    start: StartSpec = StartSpec()
    speed: ProfileSpec
    curvature: ProfileSpec
    grade: ProfileSpec | None = None
    friction: ProfileSpec | None = None
    bank: ProfileSpec | None = None
    side_wind: ProfileSpec | None = None
    path: str = ""
    hash: str = ""


class WeightsSpec(Spec, frozen=True, kw_only=True):
    """bench_configs/weights/<name>.toml (docs/reference/grading.md)."""

    schema: Literal["tunefree.weights/1"]
    name: str
    description: str = ""
    against: Literal["current", "original"]  # which trajectory the errors are taken against
    as_published: bool = False  # True keeps the source's slip in heading_err_rate_std_harsh
    metrics: dict[str, float]
    largest_value: float = 0.0  # a metric counts up to this value; 0: whatever it is
    replan_penalty: float = 1.0
    failure_score: float = 10.0
    lane_half_width_m: float = 2.0
    divergence_heading_rad: float = 1.5707963267948966
    path: str = ""


class ControllerSpec(Spec, frozen=True, kw_only=True):
    lateral: str = "lqr"
    longitudinal: str = "pid"
    inner: str = "mrac"
    riccati: Literal["converged", "apollo150"] = "converged"
    look_ahead_m: float = 0.0
    mrac_order: Literal[1, 2, 3, 4] = 1  # of the reference model (control/mrac_model.py)
    mrac_form: Literal["apollo", "paper"] = "apollo"  # the shipped law, or eq. 6 alone: no bounds, clamp or dead zone
    mrac_dead_zone: float = 0.5  # percent of the steering limit within which MRAC does not adapt; 0: as published
    calibration: str = ""  # another calibration.npz than the model's
    steering_map: str | None = None  # a steering_map.toml, or DATA_SHEET_STEERING; None or '': the model's
    parameters: dict[str, float] = field(default_factory=dict)  # names: docs/reference/controller.md, or its own
    command: list[str] = field(default_factory=list)  # starts a controller of the user's own instead of ours


class ParameterSpec(Spec, frozen=True, kw_only=True):
    name: str
    low: float = 0.0
    high: float = 0.0
    scale: Literal["log", "linear"] = "log"
    step: float | None = None
    choices: list[float] | None = None


class TuneSpec(Spec, frozen=True, kw_only=True):
    set: Literal["", "mrac", "lateral", "complete"] = ""
    parameters: list[ParameterSpec] = field(default_factory=list)
    trials: int = 40
    sampler: Literal[
        "auto",
        "gp_ei",
        "gp_ucb",
        "gp_me",
        "tpe_independent",
        "tpe_relative",
        "cma",
        "tpe_cma",
        "trust_region",
        "nsga",
        "qmc",
        "random",
    ] = "tpe_independent"
    kappa_w: float = 2.0  # weight of the uncertainty for gp_ucb (eq. 8); source: tune/sampling/records.py
    backend: Literal["bus", "batch"] = "bus"  # of the trials; the best ones of a batch are confirmed over the bus
    in_flight: int = 0  # trials asked together; 0: 8 in a batch, 1 over the bus
    box: Literal["", "default", "paper"] = ""  # '': default in a bench file with [require], else paper
    starts: Literal["first", "manual"] = "first"  # the first trials: one manual set, or all
    objectives: list[Literal["tracking", "comfort"]] = field(default_factory=list)  # empty: the score
    slower: float = 1.5  # the winner drives calmly with actuators so many times slower too; 1: by grade alone


class FaultSpec(Spec, frozen=True, kw_only=True):
    """A scripted fault at ticks from_tick <= k < to_tick; kinds and what `value` means: config/fault_check.py.

    driver_override: channel throttle|brake|steer|gear, value = the driver's input; peer_stop: channel ecu|controller;
    every other kind disturbs the frames of `message`, where they are sent. Chance comes from (seed, tick).
    """

    channel: str = ""
    message: str = ""
    kind: str
    from_tick: int
    to_tick: int
    value: float = 0.0
    seed: int = 1


class RoadsSpec(Spec, frozen=True, kw_only=True):
    """Sets of made roads beside the named scenarios, such as 'families:20'; '' for none."""

    search: str = ""
    verify: str = ""
    seed: int = 1


class BenchSpec(Spec, frozen=True, kw_only=True):
    """A bench file: one run's complete description. `path` is set by load_bench."""

    schema: Literal["tunefree.bench/1"]
    vehicle: str
    model: str
    verify_model: str = ""
    scenarios: list[str] = field(default_factory=list)
    verify_scenarios: list[str] = field(default_factory=list)
    roads: RoadsSpec | None = None
    weights: str = "default"
    seed: int = 1
    controller: ControllerSpec = ControllerSpec()
    tune: TuneSpec = TuneSpec()
    require: RequireSpec | None = None
    ensemble: EnsembleSpec | None = None
    effects: list[EffectSpec] = field(default_factory=list)
    faults: list[FaultSpec] = field(default_factory=list)
    path: str = ""


def field_values(spec: Spec) -> dict[str, Any]:
    """The fields of a struct by name; structs in them stay structs."""
    return asdict(spec)


def with_controller(spec: BenchSpec, command: list[str]) -> BenchSpec:
    """The same bench with another controller program; none given: the bench's own."""
    return replace(spec, controller=replace(spec.controller, command=command)) if command else spec


def with_scenarios(spec: BenchSpec, scenarios: list[str], verify_scenarios: list[str]) -> BenchSpec:
    """The same bench with other scenarios."""
    return replace(spec, scenarios=scenarios, verify_scenarios=verify_scenarios)


def with_source(spec: ScenarioSpec, path: str, digest: str) -> ScenarioSpec:
    """The same scenario with the path of its file and the SHA-256 of its bytes."""
    return replace(spec, path=path, hash=digest)


def value_of(number: Number) -> float:
    """The value of a number with or without interval."""
    return number.value if isinstance(number, Interval) else float(number)
