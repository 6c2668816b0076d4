"""Drives of a car whose law is known: pedals held for a while, dead time and lag between command and acceleration."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.drives.drive import Drive

DT_S = 0.01
REST = 0.15
DEAD_S, LAG_S = 0.06, 0.12


@cache
def vehicle() -> VehicleSpec:
    """Its folder."""
    return load_vehicle("mkz_bywire")


def law(speed_mps: float, throttle: float, brake: float) -> float:
    """Level and steady: creep, engine drag, a throttle that saturates and fades, a brake with a dead band."""
    coast = 0.4 * max(0.0, 1.0 - speed_mps / 2.0) - 0.12 - 0.0015 * speed_mps * speed_mps
    push = 3.0 * (1.0 - math.exp(-max(0.0, throttle - 0.17) / 0.12)) / math.sqrt(1.0 + (speed_mps / 9.0) ** 2)
    return coast + push - 24.0 * max(0.0, brake - 0.19)


def pedal_drive(
    seconds: float = 240.0,
    seed: int = 0,
    *,
    dead_s: float = DEAD_S,
    lag_s: float = LAG_S,
    top_mps: float = 18.0,
    brakes: bool = True,
    name: str = "made.log",
) -> Drive:
    """One drive from a roll of 6 m/s; with brakes=False the car is only let roll."""
    rng = np.random.default_rng(seed)
    rows = round(seconds / DT_S)
    throttle, brake = np.full(rows, REST), np.full(rows, REST)
    speed, accel = np.zeros(rows), np.zeros(rows)
    v, felt, until, slowing = 6.0, 0.0, 0, False
    dead = round(dead_s / DT_S)
    for k in range(rows):
        if k >= until:
            until = k + int(rng.integers(60, 250))
            slowing = v > top_mps or (v > 1.5 and rng.random() < 0.45)
            push, slow = (REST, rng.uniform(REST, 0.34)) if slowing and brakes else (rng.uniform(REST, 0.7), REST)
            if slowing and not brakes:
                push = REST
            if rng.random() < 0.15:
                push = slow = REST
        if v < 0.6:
            slow = REST
        throttle[k], brake[k] = push, slow
        at = max(k - dead, 0)
        felt += (law(v, throttle[at], brake[at]) - felt) * DT_S / (lag_s + DT_S)
        v = max(v + felt * DT_S, 0.0)
        speed[k], accel[k] = v, felt
    noise = rng.standard_normal((4, rows))
    fields = {
        "command.throttle_frac": throttle,
        "command.brake_frac": brake,
        "command.steer_rad": np.zeros(rows),
        "report.throttle_frac": throttle.copy(),
        "report.brake_frac": brake.copy(),
        "report.steer_rad": 0.01 * noise[0],
        "report.speed_mps": speed + 0.012 * noise[1],
        "report.accel_mps2": accel + 0.04 + 0.05 * noise[2],
        "report.lateral_accel_mps2": np.zeros(rows),
        "report.gear": np.full(rows, GEAR_DRIVE),
        "ins.accel_mps2": accel + 0.05 * noise[3],
    }
    return Drive(name, "sha256:made", DT_S, fields, {}, np.ones(rows, dtype=bool))


@cache
def some_drive() -> Drive:
    """One for all tests that only need one."""
    return pedal_drive()


def changed(drive: Drive, **fields: np.ndarray | None) -> Drive:
    """The same drive with other fields (report__speed_mps for 'report.speed_mps'); None takes one away."""
    new = {**drive.fields, **{name.replace("__", "."): values for name, values in fields.items()}}
    return drive._replace(fields={name: values for name, values in new.items() if values is not None})
