"""Inputs of the controller parts, and the export CONTROLLER of a file of `lateral/`, `longitudinal/`, `inner/`.

A part is a `Recipe` (its constants are computed from the vehicle when a bench is built: LQR gain table, MRAC start
gains) or a plain `Block` whose params are a NamedTuple with one field for each of its tunables.

    lateral       x = (Tracking, Measurement)                 -> steering-wheel angle demand, rad
    longitudinal  x = (Tracking, Measurement)                 -> Pedals
    inner         x = (steer demand rad, measured rad, m/s)   -> InnerAnswer
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block, Tunable
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.records import Measurement

RISE_PER_TAU = 2.2  # 10 to 90 % rise time of a first-order lag


class VehicleConstants(NamedTuple):
    """Vehicle constants of the controller (vehicle.toml: nominal, limits, latency). Stiffness is per AXLE.

    The defaults are the MKZ of docs/reference/apollo.md. Pedals are in duty as on the wire.
    """

    mass_kg: float = 2080.0
    wheelbase_m: float = 2.8448
    front_axle_m: float = 1.4224  # centre of mass to front axle
    yaw_inertia_kgm2: float = 4208.3
    steer_ratio: float = 16.0
    front_stiffness_n_per_rad: float = 155494.663
    rear_stiffness_n_per_rad: float = 155494.663
    rest_pedal_frac: float = 0.15
    steer_limit_rad: float = 8.20305
    steer_rate_radps: float = 8.55211
    throttle_limit_frac: float = 0.8
    brake_limit_frac: float = 0.5
    accel_low_mps2: float = -6.0
    accel_high_mps2: float = 2.0
    lateral_accel_mps2: float = 5.0
    steer_dead_time_s: float = 0.1
    steer_rise_time_s: float = 0.17

    @property
    def rear_axle_m(self) -> float:
        """Centre of mass to rear axle."""
        return self.wheelbase_m - self.front_axle_m


class Pedals(NamedTuple):
    """Output of a longitudinal part."""

    throttle_frac: float
    brake_frac: float
    accel_mps2: float  # demanded acceleration


class InnerAnswer(NamedTuple):
    """Output of an inner part. status: 0, +/-1 limited in size, +/-2 limited in rate (docs/reference/apollo.md)."""

    steer_rad: float
    status: float


class LeadLag(NamedTuple):
    """Low-speed lead-lag G(s) = beta (tau s + 1)/(alpha tau s + 1) on -lateral error (docs/reference/apollo.md).

    weight 0, the default, switches it off: as shipped (weight 1, alpha = beta = 1, tau = 0) it adds 1 rad of road wheel
    per metre of error below 3 m/s. That is five times the K1 of any Q in the published box, it is not in the paper's
    eq. 3, and it would mask the effect of Q at low speed.
    """

    weight: float = 0.0
    alpha: float = 1.0
    beta: float = 1.0
    tau_s: float = 0.0
    state_limit: float = 3000.0


class Settings(NamedTuple):
    """Settings, neither tuned nor constants of the vehicle. Defaults are those of Apollo (docs/reference/apollo.md)."""

    lead_lag: LeadLag = LeadLag()
    cutoff_hz: float = 10.0
    hold_speed_mps: float = 0.081  # below it the steering command is held
    lane_half_width_m: float = 2.0
    divergence_heading_rad: float = 1.5707963267948966
    mrac_form: str = "apollo"  # or "paper": eq. 5 and 6 only
    mrac_order: int = 1  # of the reference model: 1 to 4 (control/mrac_model.py)
    mrac_natural_radps: float = 10.0  # reference model of order 2
    mrac_damping: float = 0.9
    mrac_anti_windup: float = 1e-4
    mrac_dead_zone: float = 0.0  # percent of the steering limit; 0: as published (a bench file's default is above 0)
    mrac_shape: tuple[float, float, float] | None = None  # order 2: P / p as (p11, p12, p22); None: solved


class LoopDelays(NamedTuple):
    """Time from a command to the vehicle's answer, as identified: what preview and prediction reach over.

    Args:
        steer_dead_time_s, steer_lag_s: of the steering actuator; a lag of second order as its equivalent first order.
        drive_dead_time_s, drive_lag_s: of the slower one of throttle and brake.
        bus_s: report delay plus command delay.
    """

    steer_dead_time_s: float = 0.0
    steer_lag_s: float = 0.0
    drive_dead_time_s: float = 0.0
    drive_lag_s: float = 0.0
    bus_s: float = 0.0


NO_DELAYS = LoopDelays()


@dataclass(frozen=True)
class Setup:
    """Inputs of a recipe. `values`: every parameter by name; `absent`: record fields the vehicle lacks.

    `steering` and `delays` are what was identified of the vehicle; the paper's parts (lqr, pid, mrac) use neither.
    is_bound_by_map: the bound of the steering (limits.py), also that of mrac, is that of the steering map.
    is_realtime: the drive is at the pace of wall time, so that a part may limit its own computing time.
    path: of the first drive; a part that keeps it has it in a field `path` of its params, which later drives replace.
    """

    values: Mapping[str, float]
    vehicle: VehicleConstants
    calibration: Any  # control.calibration_map.CalibrationMap
    settings: Settings
    dt_s: float
    absent: frozenset[str] = frozenset()
    steering: Any = None  # control.steering_map.SteeringMap
    delays: LoopDelays = NO_DELAYS
    is_bound_by_map: bool = False
    is_realtime: bool = False
    path: Any = None  # control.path.Path


class Recipe(NamedTuple):
    """A part that is computed at build time: make(setup) -> Block.

    loop_lag_s: of an inner part, the lag from the steering demand to the wheel with it; None: the actuator's own.
    knows_steering: of a lateral part: it steers by the steering map; the bound of the steering then uses the map too.
    defaults: values of its own tunables by name; of those that are not in it, the middle of the box.
    has_failed: (params, state) of the part -> whether it cannot control the vehicle any more (cascade.py).
    is_kernel: its step can be compiled for the batch.
    """

    make: Callable[[Setup], Block]
    tunables: tuple[Tunable, ...] = ()
    loop_lag_s: Callable[[Setup], float] | None = None
    knows_steering: bool = False
    defaults: Mapping[str, float] = MappingProxyType({})
    has_failed: Callable[[Any, Any], bool] | None = None
    is_kernel: bool = True


def chassis_speed_of(absent: Collection[str]) -> float:
    """1 where the vehicle's chassis reports its speed, 0 where it does not; for `speed_of`."""
    return 0.0 if "report.speed_mps" in absent else 1.0


@kernel
def speed_of(measurement: Measurement, chassis_speed: float) -> float:
    """The speed for gains, map and bounds: of the chassis (docs/reference/apollo.md), else of the INS."""
    return measurement.report.speed_mps if chassis_speed != 0.0 else measurement.ins.speed_mps


def with_loop_lag(setup: Setup, inner: Recipe | Block) -> Setup:
    """The setup with the steering lag that the outer loops see through an inner part."""
    loop_lag_s = getattr(inner, "loop_lag_s", None)
    if loop_lag_s is None:
        return setup
    return replace(setup, delays=setup.delays._replace(steer_lag_s=loop_lag_s(setup)))


def bind(part: Recipe | Block, setup: Setup) -> Block:
    """The Block of a part with the values of `setup`; params of a plain Block get them by name (after the last dot)."""
    if isinstance(part, Recipe):
        return part.make(setup)
    fields = {tunable.name.rpartition(".")[2]: tunable.name for tunable in part.tunables}
    lacking = sorted(name for field, name in fields.items() if field not in getattr(part.params, "_fields", ()))
    if lacking:
        raise InputError(
            f"tunables without a field in the params of the part: {', '.join(lacking)}",
            code="bad_part",
            hint="params is a NamedTuple with one float field for each tunable, named after its last dot",
        )
    known = {field: float(setup.values[name]) for field, name in fields.items() if name in setup.values}
    return part._replace(params=part.params._replace(**known)) if known else part
