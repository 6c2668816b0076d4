"""Tyres of the reference vehicle: load-sensitive, combined slip by the friction ellipse, relaxation length.

Side force = D sin(C atan(B slip)), after the sine form of Pacejka. Slip is a state that
follows over the relaxation length, so a standing tyre holds and nothing is divided by zero.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.units import G_MPS2

SHAPE = 1.3  # C of the sine form
LOAD_ON_GRIP = 0.06  # friction lost per additional nominal load
LOAD_ON_STIFFNESS = 0.15  # the same for the stiffness
LEAST_N = 100.0  # least load of a wheel
ABS_FRAC = 0.95  # greatest share of the grip along the wheel, so that some is left for steering


class Tyre(NamedTuple):
    """One wheel during one step: B, sideways D, force along the wheel, and direction of the wheel."""

    stiff: float
    peak_n: float
    along_n: float
    cosine: float
    sine: float


@kernel
def tyre_of(
    stiffness: float, load_n: float, nominal_n: float, friction: float, asked_n: float, cosine: float, sine: float
) -> Tyre:
    """The tyre of a wheel now; stiffness [N/rad] at nominal load, demanded force along it (brakes negative)."""
    carried_n = max(load_n, LEAST_N)
    share = carried_n / max(nominal_n, LEAST_N)
    over = share - 1.0
    grip_n = max(friction * carried_n * (1.0 - LOAD_ON_GRIP * over), 1.0)
    most_n = ABS_FRAC * grip_n
    along_n = asked_n
    if along_n > most_n:
        along_n = most_n
    elif along_n < -most_n:
        along_n = -most_n
    peak_n = math.sqrt(grip_n * grip_n - along_n * along_n)
    slope = max(stiffness * share * (1.0 - LOAD_ON_STIFFNESS * over), 1.0)
    return Tyre(slope / (SHAPE * grip_n), peak_n, along_n, cosine, sine)


@kernel
def side_n(tyre: Tyre, slip: float) -> float:
    """Side force, to the left for positive slip."""
    return tyre.peak_n * math.sin(SHAPE * math.atan(tyre.stiff * slip))


class Chassis(NamedTuple):
    """Constants of the reference car, laden."""

    mass_kg: float
    inverse_mass: float
    inverse_inertia: float
    front_axle_m: float
    rear_axle_m: float
    wheelbase_m: float  # not 0
    half_track_m: float
    height_m: float
    roll_front_frac: float
    front_stiffness: float  # of one wheel
    rear_stiffness: float
    front_load_n: float  # of one wheel, laden, level
    rear_load_n: float
    nominal_front_n: float  # unladen: the load that the stiffness belongs to
    nominal_rear_n: float
    friction: float
    inverse_relaxation: float
    hold_s: float  # damping of the tyre at standstill
    compliance: float  # rad of road wheel per N of front side force
    inverse_ratio: float
    wheel_radius_m: float
    inverse_radius: float
    inverse_slip: float  # longitudinal slip per N
    body_lag_s: float
    drive_lag_s: float
    drive_front_frac: float  # share of the drive on the front axle: 1 front-wheel drive, 0 rear
    brake_front_frac: float
    hysteresis_frac: float  # duty of the tables
    rest_frac: float  # the car's own duty at rest
    throttle_scale: float  # table duty per own duty
    brake_scale: float
    shift_gain: float
    rolling_n: float
    drag_kgpm: float
    grade_rad: float
    power_w: float  # inf: the power of the tables
    brake_drag_n: float
    brake_loss_per_j: float
    head_wind_mps: float
    wind_n: float  # force of the wind on a standing car, backwards
    side_force_n: float  # of wind, to the left
    side_wind_mps2: float  # the same over the mass
    bank_rad: float
    maps: Any


class Loads(NamedTuple):
    """Acceleration that determines the wheel loads, after the lag of roll and pitch."""

    along_mps2: float
    left_mps2: float


@kernel
def four_tyres(
    p: Chassis, loads: Loads, road_frac: float, front_asked_n: float, rear_asked_n: float, angle_rad: float
) -> tuple[Tyre, Tyre, Tyre, Tyre]:
    """Front left, front right, rear left, rear right; demanded forces are per wheel; the inner wheel steers more."""
    pitch_n = 0.5 * p.mass_kg * loads.along_mps2 * p.height_m / p.wheelbase_m
    roll_n = 0.5 * p.mass_kg * loads.left_mps2 * p.height_m / max(p.half_track_m, 0.1)
    front_roll_n, rear_roll_n = roll_n * p.roll_front_frac, roll_n * (1.0 - p.roll_front_frac)
    friction = p.friction * road_frac
    bend = math.tan(angle_rad)
    narrow = p.half_track_m * bend / p.wheelbase_m
    left = math.atan(bend / max(1.0 - narrow, 0.1))
    right = math.atan(bend / max(1.0 + narrow, 0.1))
    front_n, rear_n = p.front_load_n - pitch_n, p.rear_load_n + pitch_n
    return (
        tyre_of(
            p.front_stiffness, front_n - front_roll_n, p.nominal_front_n, friction, front_asked_n,
            math.cos(left), math.sin(left),
        ),
        tyre_of(
            p.front_stiffness, front_n + front_roll_n, p.nominal_front_n, friction, front_asked_n,
            math.cos(right), math.sin(right),
        ),
        tyre_of(p.rear_stiffness, rear_n - rear_roll_n, p.nominal_rear_n, friction, rear_asked_n, 1.0, 0.0),
        tyre_of(p.rear_stiffness, rear_n + rear_roll_n, p.nominal_rear_n, friction, rear_asked_n, 1.0, 0.0),
    )  # fmt: skip


def static_loads_n(mass_kg: float, front_axle_m: float, wheelbase_m: float) -> tuple[float, float]:
    """Load of one front and one rear wheel at standstill."""
    half_n = 0.5 * mass_kg * G_MPS2
    return half_n * (wheelbase_m - front_axle_m) / wheelbase_m, half_n * front_axle_m / wheelbase_m
