"""The records of a simulated vehicle, and what a kind of plant must export.

A vehicle is actuators (Command -> Actuation), a chassis (ChassisInput -> Motion) and sensors
(SensorInput -> Measurement); `plant/vehicle.py` puts them together with the effects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Set
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import Actuation, Command, Disturbance, Measurement, Motion

REST_FRAC = 0.15  # duty of a released pedal (docs/reference/by_wire.md)


class Driver(NamedTuple):
    """The driver's inputs from a script: duty of both pedals, steering torque, gear lever.

    steer_hold = 1 holds the wheel against the motor; gear_override = 1 moves the lever. fault_cause injects a
    watchdog code of `bywire.CAUSES` that commands cannot cause (another module, a report time-out).
    """

    throttle_frac: float = REST_FRAC
    brake_frac: float = REST_FRAC
    steer_torque_nm: float = 0.0
    steer_hold: float = 0.0
    gear_override: float = 0.0
    fault_cause: float = 0.0


NO_DRIVER = Driver()  # both pedals released


class ChassisInput(NamedTuple):
    """Input of the chassis at one step."""

    actuation: Actuation
    road: Disturbance


class ChassisParams(NamedTuple):
    """Params of every chassis Block: its own constants (with `wheel_radius_m`, `half_track_m`), and its start."""

    constants: Any
    start: Start = Start()


class BodyInput(NamedTuple):
    """One tick of the vehicle: the command applied by the by-wire unit, the driver, the road."""

    command: Command
    driver: Driver
    road: Disturbance


class BodyOutput(NamedTuple):
    """After the tick: output of the actuators, true motion, and measurement."""

    actuation: Actuation
    motion: Motion
    measurement: Measurement


class Plant(NamedTuple):
    """The export PLANT of a plant kind.

    make(params, change) -> chassis Block on ChassisParams. actuators(params) -> Block Command -> Actuation for a
    whole vehicle with its own actuators, else None (`[actuators]` of model.toml); dead_times and lags then name the
    keys of [plant.params] that are their times. The whole vehicle is stepped `substeps` times a tick. `defaults`:
    every key that [plant.params] may set, with its default.

    open(path) -> Plant: the plant with the content of its file in the model folder (`file`, unless [plant] names
    another); None for a kind without a file. observe(state, motion) -> state: the chassis's state with a measured
    motion.
    """

    make: Callable[[Mapping[str, float], BodyChange], Block]
    defaults: Mapping[str, float]
    substeps: int = 1
    actuators: Callable[[Mapping[str, float]], Block] | None = None
    dead_times: tuple[str, ...] = ()
    lags: tuple[str, ...] = ()
    open: Callable[[Path], Any] | None = None
    file: str = ""
    observe: Callable[[Any, Motion], Any] | None = None


def unopened(kind: str) -> Callable[[Mapping[str, float], BodyChange], Block]:
    """`Plant.make` of a kind that needs its file: raises InputError."""

    def make(params: Mapping[str, float], change: BodyChange) -> Block:
        raise InputError(
            f"a plant of kind {kind!r} is in its file, and none was opened",
            code="no_plant_file",
            key="plant.file",
            hint="name a model folder that has it",
        )

    return make


class Laden(NamedTuple):
    """Mass geometry of a car with its payload."""

    mass_kg: float
    front_axle_m: float  # centre of mass to front axle
    rear_axle_m: float
    yaw_inertia_kgm2: float


def laden(mass_kg: float, wheelbase_m: float, front_axle_m: float, inertia_kgm2: float, change: BodyChange) -> Laden:
    """The car with its payload on its centre line (parallel axes); without payload the given values, bit for bit."""
    total_kg = mass_kg + change.payload_kg
    shift_m = change.payload_moment_kgm / total_kg if total_kg > 0.0 else math.inf
    front_m = front_axle_m - shift_m
    inertia = inertia_kgm2 + change.payload_inertia_kgm2 - total_kg * shift_m * shift_m
    if not (0.0 < front_m < wheelbase_m and inertia > 0.0):
        raise InputError(
            f"{change.payload_kg} kg of payload put the centre of mass {front_m:.3g} m behind the front axle",
            code="bad_payload",
            key="payload",
            hint="the laden mass must be positive and the centre of mass between the axles",
        )
    return Laden(total_kg, front_m, wheelbase_m - front_m, inertia)


def more_drag_m2(own_m2: float, change: BodyChange) -> float:
    """Drag area with the additions of effects; InputError for a negative sum."""
    area_m2 = own_m2 + change.drag_area_m2
    if area_m2 < 0.0:
        raise InputError(
            f"a drag area of {own_m2:g} m2 and {change.drag_area_m2:g} m2 more",
            code="bad_drag_area",
            key="aero_drag",
            hint="an effect may take away no more drag than the car has",
        )
    return area_m2


def rolling_share(change: BodyChange) -> float:
    """Rolling resistance as a multiple of the car's own; InputError for a negative sum."""
    share = 1.0 + change.rolling_extra_frac
    if share < 0.0:
        raise InputError(
            f"{change.rolling_extra_frac:g} of the rolling resistance more",
            code="bad_rolling_resistance",
            key="rolling_resistance",
            hint="effects may take away no more rolling resistance than the car has",
        )
    return share


CHANGES = {
    "payload_kg": "payload",
    "payload_moment_kgm": "payload.ahead_m",
    "payload_inertia_kgm2": "payload.ahead_m",
    "friction_frac": "friction",
    "grade_rad": "grade",
    "power_w": "power_limit",
    "brake_drag_n": "brake_drag",
    "brake_loss_per_mj": "brake_fade",
    "front_stiffness_frac": "front_stiffness",
    "rear_stiffness_frac": "rear_stiffness",
    "relaxation_m": "tyre_relaxation",
    "rolling_extra_frac": "rolling_resistance",
    "drag_area_m2": "aero_drag",
    "head_wind_mps": "head_wind",
    "side_force_n": "side_wind",
    "bank_rad": "road_bank",
}  # field of BodyChange -> the effect that sets it


def refuse_changes(kind: str, change: BodyChange, able: Set[str]) -> None:
    """InputError for changed fields that are not in `able`, the fields of BodyChange that a kind can apply."""
    neutral = BodyChange()._asdict()
    changed = [name for name, value in change._asdict().items() if name not in able and value != neutral[name]]
    if changed:
        effects = ", ".join(dict.fromkeys(CHANGES[name] for name in changed))
        raise InputError(
            f"a plant of kind {kind!r} has no physics that {effects} could change",
            code="not_in_this_plant",
            key="effects",
            hint="take a model of kind hybrid or physics, or leave the effect out",
        )


def filled(defaults: Mapping[str, float], given: Mapping[str, float], kind: str) -> dict[str, float]:
    """`defaults` updated with the given values; InputError for an unknown key."""
    unknown = sorted(set(given) - set(defaults))
    if unknown:
        raise InputError(
            f"plant kind {kind!r} has no parameter {', '.join(unknown)}",
            code="unknown_plant_parameter",
            key=f"plant.params.{unknown[0]}",
            hint=f"it has {', '.join(defaults)}",
        )
    return {**defaults, **{key: float(value) for key, value in given.items()}}


def rolling_motion(start: Start, wheel_radius_m: float) -> Motion:
    """Motion of a car that rolls straight on level ground at `start`; the first motion of every chassis."""
    wheel_radps = start.speed_mps / wheel_radius_m
    wheels = (wheel_radps, wheel_radps, wheel_radps, wheel_radps)
    speeds = (start.speed_mps, 0.0, 0.0)
    forces = (0.0, 0.0, 0.0)
    return Motion(start.x_m, start.y_m, start.heading_rad, *speeds, *forces, *wheels)
