"""Pedal maps and gearbox of the reference vehicle, from the published tables (docs/reference/apollo.md).

Drive: the calibration table's accelerations less its coasting, as a force at 1736 kg, bilinear in speed and duty.
Above 10 m/s, the end of the table, each duty has constant power. Coasting (creep below 2 m/s, engine drag
above) is the table's with pedals at rest. Brake: the by-wire supplier's duty-to-torque table with hysteresis; it is
flat above 0.326 duty, unlike the calibration table, and at 0.22 duty it gives more than that table. Another vehicle has
the same shapes scaled by `MapShape`: duty, forces, shift speeds, and self-energising drum brakes. The MKZ's shape
changes no bit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.kernel import kernel, table
from tunefree_hil.base.maths import clamp, find_cell, lerp_table
from tunefree_hil.base.units import AIR_DENSITY_KGPM3, G_MPS2

MAP_MASS_KG = 1736.35  # the car that the tables describe (docs/reference/by_wire.md)
MAP_REST_FRAC = 0.15  # duty of its released pedals
LAST_MPS = 10.0  # end of the calibration table
SPEEDS_MPS = (0.0, 0.4, 1.0, 2.0, 3.0, 5.0, 7.0, LAST_MPS)
COAST_MPS2 = (0.40, 0.38, 0.28, -0.05, -0.12, -0.19, -0.24, -0.27)
THROTTLE_FRAC = (0.15, 0.17, 0.20, 0.22, 0.25, 0.30, 0.35, 0.40, 0.50, 0.60, 0.80)
THROTTLE_MPS2 = (  # one row a speed, one column a duty from 0.17 on
    (0.37, 0.72, 0.97, 1.40, 1.53, 1.65, 1.79, 1.94, 2.11, 2.30),
    (0.43, 0.82, 1.07, 1.57, 1.78, 1.94, 2.12, 2.24, 2.47, 2.71),
    (0.32, 0.89, 1.25, 1.89, 2.20, 2.49, 2.66, 2.56, 2.67, 2.73),
    (0.05, 0.70, 1.22, 2.05, 2.51, 2.85, 2.99, 2.98, 3.01, 2.96),
    (0.03, 0.31, 0.76, 1.72, 2.58, 2.94, 3.16, 3.17, 3.14, 3.05),
    (-0.08, 0.11, 0.34, 0.86, 1.80, 2.46, 2.87, 3.10, 3.24, 3.16),
    (-0.10, 0.06, 0.22, 0.55, 1.21, 1.88, 2.34, 2.75, 3.23, 3.20),
    (-0.21, -0.08, 0.08, 0.32, 0.75, 1.30, 1.71, 2.17, 2.94, 2.99),
)
BRAKE_FRAC = (0.150, 0.175, 0.184, 0.208, 0.211, 0.234, 0.246, 0.283, 0.305, 0.323, 0.326)
BRAKE_NM = (0.0, 0.0, 4.0, 108.0, 519.0, 521.0, 816.0, 1832.0, 2612.0, 3316.0, 3412.0)

UPSHIFT_MPS = (4.5, 8.5, 13.0, 19.0)  # at part throttle; assumed, like all of the gearbox
TOP_GEAR = float(len(UPSHIFT_MPS))
DOWNSHIFT_SHARE = 0.8
LATE_SHARE = 0.5  # share by which full throttle raises the shift speeds
SHIFT_S = 0.3
HOLE_FRAC = 0.3  # share of the drive lost in the middle of a shift
TOOTH_FRAC = 0.06  # share of the drive lost towards the end of a gear


class Maps(NamedTuple):
    """The tables for the kernels; drive_n is row by row over the duties."""

    speed_mps: Any
    idle_n: Any  # creep and engine drag, positive forward
    duty: Any
    drive_n: Any
    brake_duty: Any
    brake_n: Any
    upshift_mps: Any


class MapShape(NamedTuple):
    """Another vehicle than that of the tables: factors on their forces and speeds, 1 for that one.

    brake_servo: self-energising share of the brake force at the table's last force (0: disc).
    """

    drive_gain: float = 1.0
    idle_gain: float = 1.0
    brake_gain: float = 1.0
    brake_servo: float = 0.0
    shift_gain: float = 1.0


AS_PUBLISHED = MapShape()


class Gearbox(NamedTuple):
    """Gear in use (0 is the lowest) and the remaining time of a shift."""

    gear: float
    shift_s: float


def maps_of(rolling_frac: float, drag_area_m2: float, wheel_radius_m: float, shape: MapShape = AS_PUBLISHED) -> Maps:
    """Tables in newtons, plus rolling resistance and drag, so that the net force is the published one."""
    most_nm = max(BRAKE_NM)
    drag = 0.5 * AIR_DENSITY_KGPM3 * drag_area_m2
    idle = [
        (MAP_MASS_KG * (coast + rolling_frac * G_MPS2) + drag * speed * speed) * shape.idle_gain
        for speed, coast in zip(SPEEDS_MPS, COAST_MPS2, strict=True)
    ]
    drive = [
        MAP_MASS_KG * max(accel - coast, 0.0) * shape.drive_gain
        for row, coast in zip(THROTTLE_MPS2, COAST_MPS2, strict=True)
        for accel in (coast, *row)
    ]
    return Maps(
        table(SPEEDS_MPS),
        table(idle),
        table(THROTTLE_FRAC),
        table(drive),
        table(BRAKE_FRAC),
        table(
            torque / wheel_radius_m * shape.brake_gain * (1.0 + shape.brake_servo * torque / most_nm)
            for torque in BRAKE_NM
        ),
        table(speed * shape.shift_gain for speed in UPSHIFT_MPS),
    )


@kernel
def table_duty(duty: float, rest_frac: float, scale: float) -> float:
    """The tables' duty for a pedal that rests at rest_frac; scale: tables' duty per own duty. Exact for the MKZ."""
    return duty + (duty - rest_frac) * (scale - 1.0) + (MAP_REST_FRAC - rest_frac)


@kernel
def drive_force_n(maps: Maps, duty: float, speed_mps: float) -> float:
    """Drive force of a duty at a speed, without the gearbox; constant power above the table's last speed."""
    grid, duties = maps.speed_mps, maps.duty
    columns = len(duties)
    speed = speed_mps if speed_mps < LAST_MPS else LAST_MPS
    duty_in_table = clamp(duty, duties[0], duties[columns - 1])
    i, j = find_cell(grid, speed), find_cell(duties, duty_in_table)
    across = (duty_in_table - duties[j]) / (duties[j + 1] - duties[j])  # not 0: the duties ascend
    along = (speed - grid[i]) / (grid[i + 1] - grid[i])  # not 0: the speeds ascend
    cell = i * columns + j
    low = maps.drive_n[cell] + across * (maps.drive_n[cell + 1] - maps.drive_n[cell])
    cell = cell + columns
    high = maps.drive_n[cell] + across * (maps.drive_n[cell + 1] - maps.drive_n[cell])
    force_n = float(low + along * (high - low))
    return force_n if speed_mps <= LAST_MPS else force_n * LAST_MPS / max(speed_mps, LAST_MPS)


@kernel
def idle_force_n(maps: Maps, speed_mps: float, brake_frac: float, rest_frac: float) -> float:
    """Creep or engine drag; creep fades out as the brake is pressed (0 from 0.10 duty on, assumed)."""
    force_n = lerp_table(maps.speed_mps, maps.idle_n, speed_mps)
    if force_n <= 0.0:
        return force_n
    return force_n * (1.0 - clamp((brake_frac - rest_frac) * 10.0, 0.0, 1.0))


@kernel
def brake_force_n(maps: Maps, duty: float) -> float:
    """Brake force of a duty (after the hysteresis)."""
    return lerp_table(maps.brake_duty, maps.brake_n, duty)


@kernel
def step_gearbox(maps: Maps, box: Gearbox, duty: float, speed_mps: float, dt_s: float) -> Gearbox:
    """Shift up or down by speed; a shift is finished before the next one."""
    if box.shift_s > 0.0:
        left_s = box.shift_s - dt_s
        return Gearbox(box.gear, left_s if left_s > 0.0 else 0.0)
    late = 1.0 + LATE_SHARE * clamp((duty - 0.25) * 2.0, 0.0, 1.0)
    if box.gear < TOP_GEAR and speed_mps > late * maps.upshift_mps[int(box.gear)]:
        return Gearbox(box.gear + 1.0, SHIFT_S)
    if box.gear > 0.5 and speed_mps < DOWNSHIFT_SHARE * maps.upshift_mps[int(box.gear) - 1]:
        return Gearbox(box.gear - 1.0, SHIFT_S)
    return box


@kernel
def gear_factor(maps: Maps, box: Gearbox, speed_mps: float) -> float:
    """Factor of the gearbox on the drive: a saw tooth over the speeds of a gear, and a dip during a shift."""
    gear = int(box.gear)
    low = maps.upshift_mps[gear - 1] if gear > 0 else 0.0
    high = maps.upshift_mps[gear] if box.gear < TOP_GEAR else 2.0 * low
    place = clamp((speed_mps - low) / max(high - low, 1.0), 0.0, 1.0)
    hole = HOLE_FRAC * math.sin(math.pi * box.shift_s / SHIFT_S) if box.shift_s > 0.0 else 0.0
    return (1.0 + TOOTH_FRAC * (0.5 - place)) * (1.0 - hole)


def first_gearbox(speed_mps: float, shift_gain: float = 1.0) -> Gearbox:
    """The gear of a car that rolls at this speed with little throttle."""
    return Gearbox(float(sum(1 for upshift in UPSHIFT_MPS if speed_mps > upshift * shift_gain)), 0.0)
