"""Schema of vehicle.toml (docs/reference/files.md): frozen structs, unknown keys refused. Other files: schema.py."""

from __future__ import annotations

from typing import Literal

from msgspec import Struct, field


class Spec(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all: frozen, keyword only, unknown keys refused."""


class SignalSpec(Spec, frozen=True, kw_only=True):
    """One signal of a sum."""

    name: str
    scale: float = 1.0


class E2eSpec(Spec, frozen=True, kw_only=True):
    """End-to-end protection of a message (functions in bus/dbc/e2e.py and bus/dbc/integrity.py).

    crc, counter, nibble name signals; max_delta is the widest step between two frames' counters that still passes.
    """

    profile: str = "none"  # P01 | P02
    data_ids: list[int] = field(default_factory=list)  # one in P01, sixteen in P02
    id_mode: str = ""  # P01: both | alternating | low | nibble
    max_delta: int = 1
    crc: str = ""
    counter: str = ""
    nibble: str = ""  # id mode nibble: the signal that carries bits 8..11 of the data id


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
    """One bit or code in a report. `bywire`: the by-wire channel that it concerns ('' = all)."""

    message: str
    signal: str
    active: float = 1
    effect: Literal["disable_all", "disable_channel", "warn"] = "disable_all"
    bywire: Literal["", "throttle", "brake", "steer", "gear"] = ""
    cause: str = ""  # watchdog codes: 'throttle_timeout', 'throttle_counter', ... (plant/actuation/bywire.py)
    assumed: str = ""


class ExtraSpec(Spec, frozen=True, kw_only=True):
    """A message that goes out on schedule and carries no record field, by its name in the DBC.

    A message that only [state] names needs no entry: its period is then the DBC's GenMsgCycleTime, or one tick.
    """

    kind: Literal["command", "telemetry"]
    period_ms: int
    channel: str = ""
    allow_truncated: bool = False
    constants: dict[str, float] = field(default_factory=dict)
    e2e: E2eSpec = E2eSpec()
    assumed: str = ""


class InsFrameSpec(Spec, frozen=True, kw_only=True):
    frame: str = "ENU"
    origin: str | list[float] = "local"
    point: str = "rear_axle"
    latency_s: float = 0.0
    assumed: str = ""


class LatencySpec(Spec, frozen=True, kw_only=True):
    """Data-sheet times of an actuator."""

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
    reverse_mps: float = 0.0  # highest speed backwards; 0: it does not, or is not known
    brake_rate_per_s: float = (
        20.0  # the by-wire unit lets the brake demand change no faster (docs/reference/by_wire.md)
    )
    watchdog_brake_frac: float = 0.30  # duty with which its watchdog brakes
    assumed: list[str] = field(default_factory=list)


class NominalSpec(Spec, frozen=True, kw_only=True):
    """Data-sheet constants. Keys may be missing; check_drive.py lists the needed ones. Stiffness is per AXLE."""

    mass_kg: float | None = None
    wheelbase_m: float | None = None
    front_axle_m: float | None = None  # centre of mass to front axle
    yaw_inertia_kgm2: float | None = None
    steer_ratio: float | None = None
    wheel_radius_m: float | None = None
    track_m: float | None = None  # between the middles of the rear wheels
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
    steer_nm: float = 3.0  # |torque of the driver's hand|
    steer_s: float = 0.1
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
    manual_gains: Literal["rule_based", "as_shipped"] = (
        "rule_based"  # as_shipped: those of docs/reference/controller.md are this one's
    )
    folder: str = ""
    hash: str = ""
