"""What the TOML files may say (interfaces 2-6): frozen structs, unknown keys refused.

Only shapes and types here; what must fit together is checked in `config/load.py`, which names file and key.
"""

from __future__ import annotations

from typing import Any, Literal

from msgspec import Struct, field


class Spec(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all: frozen, keyword only, unknown keys refused."""


# --- vehicle.toml (interfaces 2) ---------------------------------------------------------------------------------


class SignalSpec(Spec, frozen=True, kw_only=True):
    """One signal of a sum."""

    name: str
    scale: float = 1.0


class E2eSpec(Spec, frozen=True, kw_only=True):
    """End-to-end protection of a message (functions in bus/integrity.py)."""

    profile: str = "none"
    data_ids: list[int] = field(default_factory=list)
    id_mode: str = ""
    max_delta: int = 1
    crc: str = ""
    counter: str = ""


class FieldSpec(Spec, frozen=True, kw_only=True):
    """Record field <- signal. Physical value of the DBC -> SI: value * scale + offset."""

    message: str
    signal: str | list[str] = ""  # a list of four (FL FR RL RR) for wheel_speed_radps only
    signals: list[SignalSpec] = field(default_factory=list)  # their sum
    scale: float = 1.0
    offset: float = 0.0
    period_ms: int = 0  # command, report: needed; ins: needed
    channel: str = ""
    allow_truncated: bool = False
    enable: str = ""
    clear: str = ""
    ignore: str = ""
    counter: str = ""
    checksum: str = ""
    constants: dict[str, float] = field(default_factory=dict)  # other signals of the message, held at a value
    e2e: E2eSpec = E2eSpec()
    timeout_ms: int = 0
    specific_force: bool = False  # [ins.accel_mps2] only
    assumed: str = ""


class StateSpec(Spec, frozen=True, kw_only=True):
    """One bit or code in a report. `bywire` says which of the vehicle's by-wire channels it speaks of ('' = all)."""

    message: str
    signal: str
    active: float = 1
    effect: Literal["disable_all", "disable_channel", "warn"] = "disable_all"
    bywire: Literal["", "throttle", "brake", "steer", "gear"] = ""
    cause: str = ""  # watchdog codes: 'throttle_timeout', 'throttle_counter', ... (plant/bywire.py lists them)
    assumed: str = ""


class ExtraSpec(Spec, frozen=True, kw_only=True):
    """A message that goes out on schedule and carries no record field, by its name in the DBC.

    A message that only [state] speaks of needs no entry: its period is then the DBC's GenMsgCycleTime, or one tick.
    """

    kind: Literal["command", "telemetry"]
    period_ms: int
    channel: str = ""
    allow_truncated: bool = False
    constants: dict[str, float] = field(default_factory=dict)
    assumed: str = ""


class InsFrameSpec(Spec, frozen=True, kw_only=True):
    frame: str = "ENU"
    origin: str | list[float] = "local"
    point: str = "rear_axle"
    latency_s: float = 0.0
    assumed: str = ""


class LatencySpec(Spec, frozen=True, kw_only=True):
    """What a data sheet says of an actuator."""

    dead_time_s: float = 0.0
    rise_time_s: float = 0.0
    assumed: str = ""


class LimitsSpec(Spec, frozen=True, kw_only=True):
    steer_rad: float
    steer_rate_radps: float
    throttle_frac: float
    brake_frac: float
    accel_mps2: list[float] = field(default_factory=lambda: [-6.0, 2.0])  # low, high
    lateral_accel_mps2: float = 5.0
    speed_mps: float = 40.0
    assumed: list[str] = field(default_factory=list)


class NominalSpec(Spec, frozen=True, kw_only=True):
    """Data-sheet constants. Keys may be missing; what needs them says so. Stiffness is per AXLE."""

    mass_kg: float | None = None
    wheelbase_m: float | None = None
    front_axle_m: float | None = None  # centre of mass to front axle
    yaw_inertia_kgm2: float | None = None
    steer_ratio: float | None = None
    wheel_radius_m: float | None = None
    front_stiffness_n_per_rad: float | None = None
    rear_stiffness_n_per_rad: float | None = None
    rest_pedal_frac: float = 0.0
    assumed: list[str] = field(default_factory=list)


class OverrideSpec(Spec, frozen=True, kw_only=True):
    """When the driver takes over, as the by-wire unit sees it (thresholds on the driver's own pedal or wheel)."""

    brake_frac: float = 0.22
    brake_s: float = 0.1
    throttle_frac: float = 0.30
    throttle_s: float = 0.1
    driver_frac: float = 0.18
    driver_s: float = 0.02
    assumed: str = ""


class VehicleSpec(Spec, frozen=True, kw_only=True):
    """vehicle.toml. `folder` and `hash` are set by load_vehicle."""

    schema: Literal["tunefree.vehicle/1"]
    name: str
    dbc: list[str]
    bitrate: int
    data_bitrate: int | None = None
    tick_ms: int = 10
    absent: list[str] = field(default_factory=list)
    command: dict[str, FieldSpec] = field(default_factory=dict)
    report: dict[str, FieldSpec] = field(default_factory=dict)
    ins: dict[str, FieldSpec] = field(default_factory=dict)
    extra: dict[str, ExtraSpec] = field(default_factory=dict)
    ins_frame: InsFrameSpec = InsFrameSpec()
    state: dict[str, list[StateSpec]] = field(default_factory=dict)
    latency: dict[str, LatencySpec] = field(default_factory=dict)
    override: OverrideSpec = OverrideSpec()
    limits: LimitsSpec
    nominal: NominalSpec = NominalSpec()
    folder: str = ""
    hash: str = ""


# --- model.toml (interfaces 3) -----------------------------------------------------------------------------------


class Interval(Spec, frozen=True, kw_only=True):
    """A fitted value with its interval; a bare number is allowed where no interval is known."""

    value: float
    low: float
    high: float


Number = float | Interval


class ActuatorSpec(Spec, frozen=True, kw_only=True):
    """Dead time, lag of order 1 (lag_s) or 2 (natural_hz, damping), rate limit, dead band, gain, offset (design D5)."""

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
    """The region that the data covered: [low, high] each."""

    speed_mps: list[float] | None = None
    accel_mps2: list[float] | None = None
    lateral_accel_mps2: list[float] | None = None
    pedals: list[float] | None = None


class EffectSpec(Spec, frozen=True, kw_only=True):
    """An effect that was found and added, or a perturbation that a bench file asks for: one syntax."""

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


# --- scenario, weights, bench (interfaces 5) ---------------------------------------------------------------------


class StartSpec(Spec, frozen=True, kw_only=True):
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
    path: str = ""
    hash: str = ""


class WeightsSpec(Spec, frozen=True, kw_only=True):
    """bench_configs/weights/<name>.toml (design D11)."""

    schema: Literal["tunefree.weights/1"]
    name: str
    description: str = ""
    against: Literal["current", "original"]  # which trajectory the errors are taken against
    as_published: bool = False  # True keeps the source's slip in heading_err_rate_std_harsh
    metrics: dict[str, float]
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
    calibration: str = ""  # another calibration.npz than the model's
    parameters: dict[str, float] = field(default_factory=dict)  # by the names of interfaces 7


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
    sampler: Literal["tpe_independent", "tpe_relative", "random"] = "tpe_independent"
    in_flight: int = 1


class FaultSpec(Spec, frozen=True, kw_only=True):
    """A scripted fault. kind 'driver_override' (channel throttle|brake|steer|gear, value = the driver's input)."""

    channel: str
    message: str = ""
    kind: str
    from_tick: int
    to_tick: int
    value: float = 0.0
    seed: int = 1


class BenchSpec(Spec, frozen=True, kw_only=True):
    """A bench file: one run's complete description. `path` is set by load_bench."""

    schema: Literal["tunefree.bench/1"]
    vehicle: str
    model: str
    verify_model: str = ""
    scenarios: list[str]
    verify_scenarios: list[str] = field(default_factory=list)
    weights: str = "default"
    seed: int = 1
    controller: ControllerSpec = ControllerSpec()
    tune: TuneSpec = TuneSpec()
    effects: list[EffectSpec] = field(default_factory=list)
    faults: list[FaultSpec] = field(default_factory=list)
    path: str = ""


def value_of(number: Number) -> float:
    """The value of a number with or without interval."""
    return number.value if isinstance(number, Interval) else float(number)
