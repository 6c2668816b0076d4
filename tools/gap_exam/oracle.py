"""Whether an effect can be found in a log at all, decided before any answer is opened.

The exam's own car without the effect is recalibrated on every second block (a handful of gains and offsets, tight
priors) and then runs free on the other blocks, restarted from the true state every 8 s; so does the car with the effect
in it. The effect is detectable where the second leaves at least 5 % less of the held-out error than the first.
Errors count in units of what nobody can do better than: noise, the frames' resolution, and half a percent of a signal
(more for a car with background mismatch).

A model that was calibrated on logs with the effect in them has taken in what its constants can hold of it: there the
recalibration is wide (actuators' times and all forces are free), and what it takes in is no effect any more.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tools.gap_exam.bus import Noise
from tools.gap_exam.car import G_MPS2, Car
from tools.gap_exam.cases import Made
from tools.gap_exam.hidden import NOTHING, Hidden
from tools.gap_exam.simulate import replay

BLOCK, GUARD = 800, 20  # ticks
LEAST = 0.05
ROWS = (1, 3, 4, 5, 6, 11, 12, 13, 16, 17, 19)
HEADING = 16
RESOLUTION = {1: 5e-5, 3: 5e-5, 4: 9e-4, 5: 9e-4, 6: 3e-3, 11: 5e-3, 12: 5e-3, 13: 2e-4, 16: 2e-4, 17: 5e-3, 19: 2e-4}
THIN = 5  # every so many ticks count in the fit
OWN_FLOOR = 0.005
TIGHT = {"drive_n": 0.025, "brake_n": 0.025, "front_stiffness": 0.03, "rear_stiffness": 0.03, "steer_ratio": 0.02,
          "rolling_frac": 0.10, "steer_offset": 0.004}  # fmt: skip
WIDE = {"drive_n": 0.5, "drive_bend": 0.5, "drive_w": 0.7, "brake_n": 0.5, "front_stiffness": 0.5,
        "rear_stiffness": 0.5, "inertia_kgm2": 0.3, "steer_ratio": 0.3, "rolling_frac": 2.0, "drag_area_m2": 3.0,
        "steer_offset": 0.3, "steer_dead_s": 4.0, "steer_hz": 0.7, "steer_rate_radps": 0.9, "throttle_zero": 6.0,
        "throttle_dead_s": 9.0, "throttle_lag_s": 9.0, "brake_dead_s": 9.0, "brake_lag_s": 9.0,
        "brake_dead_band": 0.05}  # fmt: skip
HIDDEN = ("steer_offset", "brake_dead_band")  # of a model's constants those that stand among the effects here
# A calibration has these constants of every channel: dead time, rate limit, dead band, offset
# (docs/reference/files.md), and a lag
# behind the throttle
EXACT = ("steer_dead_time", "steer_rate_limit", "steer_dead_band", "steer_offset", "steer_report_offset",
         "throttle_dead_time", "throttle_rate_limit", "powertrain_lag", "brake_dead_time",
         "brake_dead_band")  # fmt: skip
# Where the constant is that holds more or less of an effect, as a start for the wide fit
TAKEN_IN: dict[str, tuple[str, Callable[[float, Car], float]]] = {
    "throttle_lag": ("throttle_lag_s", lambda value, car: value / car.throttle_lag_s),
    "brake_lag": ("brake_lag_s", lambda value, car: value / car.brake_lag_s),
    "throttle_dead_band": ("throttle_zero", lambda value, car: value / max(car.throttle_zero, LEAST_ZERO)),
    "brake_gain": ("brake_n", lambda value, car: value - 1.0),
    "steer_gain": ("steer_ratio", lambda value, car: 1.0 / value - 1.0),
    "front_stiffness": ("front_stiffness", lambda value, car: value - 1.0),
    "rear_stiffness": ("rear_stiffness", lambda value, car: value - 1.0),
    "rolling_resistance": ("rolling_frac", lambda value, car: value),
    "brake_drag": ("rolling_frac", lambda value, car: value / (car.rolling_frac * car.mass_kg * G_MPS2)),
    "aero_drag": ("drag_area_m2", lambda value, car: value / car.drag_area_m2),
}
LEAST_LEFT, LEAST_ZERO = 0.02, 1e-3  # of a constant; of the throttle's zero, as a duty
ROUNDS = {False: 2, True: 4}
CORRELATED = 60.0  # samples that say one thing
Array = np.ndarray


class Found(NamedTuple):
    """Errors on held-out blocks after recalibration and of the true model; what the latter removes, in all and most."""

    recalibrated: float
    true: float
    removed: float
    most_removed: float
    detectable: bool


def detect(made: Made, *, wide: bool = False, known: Hidden = NOTHING) -> Found:
    """Decide for a drive that was made. Without any effect nothing is detectable.

    wide: for a model that was calibrated with the effect in its logs. known: effects that the recalibrated car has,
    too: what is decided is whether the others can be found beside them.
    """
    scale = scales(made)
    fit, held = blocks(len(made.drive.commands))
    if made.hidden == known:
        return Found(1.0, 1.0, 0.0, 0.0, False)
    car = recalibrated(made, scale, fit, known, wide=wide)
    before = errors(made, free_run(made, *car), scale, held)
    after = errors(made, free_run(made, made.vehicle.car, made.hidden), scale, held)
    first, last = float(np.sqrt(before.mean())), float(np.sqrt(after.mean()))
    removed, most = 1.0 - last / first, float((1.0 - np.sqrt(after / before)).max())
    return Found(first, last, removed, most, removed >= LEAST)


def blocks(ticks: int) -> tuple[Array, Array]:
    """Ticks to fit on and to judge by, bool each: blocks in turn, what is at their edges left out."""
    k = np.arange(ticks)
    inside = k % BLOCK >= GUARD
    block = k // BLOCK
    return inside & (block % 2 == 0), inside & (block % 2 == 1)


def free_run(made: Made, car: Car, hidden: Hidden, begin: int = 0) -> Array:
    """Reports [K, rows] of a free run on the recorded commands, restarted every BLOCK ticks from `begin` on."""
    restart = (np.arange(len(made.drive.commands)) - begin) % BLOCK == 0
    restart[0] = True
    lost = made.lost if hidden == made.hidden else np.zeros_like(made.lost)
    run = replay(car, hidden, made.driver, made.drive.commands, made.drive.body, restart, lost)
    return run.reports[:, ROWS]


def recalibrated(
    made: Made, scale: Array, fit: Array, known: Hidden = NOTHING, *, wide: bool = False
) -> tuple[Car, Hidden]:
    """Gauss-Newton steps on the ticks of `fit`, without the effect but with what is known."""
    if wide:
        known = known._replace(**{name: getattr(made.hidden, name) for name in EXACT})
    rows = np.flatnonzero(fit)[::THIN]
    weight = np.sqrt(THIN / CORRELATED) / scale
    priors = WIDE if wide else TIGHT
    names, sigma = list(priors), np.array(list(priors.values()))
    measured = made.drive.reports[rows][:, ROWS]

    def residual(x: Array) -> Array:
        run = free_run(made, *_with(made.vehicle.car, known, dict(zip(names, x, strict=True))))
        return ((run[rows] - measured) * weight).clip(-50.0, 50.0).ravel()

    at = _start(made, names) if wide else np.zeros(len(names))
    best, least = at, math.inf
    for _ in range(ROUNDS[wide] + 1):
        here = residual(at)
        size = float(here @ here + (at / sigma) @ (at / sigma))
        if size < least:
            best, least = at, size
        step = np.minimum(0.2 * sigma, 0.03)
        slope = np.stack([(residual(at + d * unit) - here) / d
                          for d, unit in zip(step, np.eye(len(names)), strict=True)], axis=1)  # fmt: skip
        normal = slope.T @ slope + np.diag(1.0 / sigma**2)
        at = np.clip(at + np.linalg.solve(normal, -slope.T @ here - at / sigma**2), -3.0 * sigma, 3.0 * sigma)
    here = residual(at)
    return _with(made.vehicle.car, known, dict(zip(names, at if here @ here < least else best, strict=True)))


def _start(made: Made, names: list[str]) -> Array:
    """Where a wide fit begins: with what an effect comes to where a constant can hold it."""
    at = dict.fromkeys(names, 0.0)
    for effect, (constant, share) in TAKEN_IN.items():
        value = getattr(made.hidden, effect)
        if value != getattr(NOTHING, effect):
            at[constant] += share(value, made.vehicle.car)
    return np.array(list(at.values()))


def _with(car: Car, known: Hidden, off: dict[str, float]) -> tuple[Car, Hidden]:
    """The car with its constants off by these shares; what stands among the effects is off by so much."""
    shares = {name: value for name, value in off.items() if name not in HIDDEN}
    values = {name: getattr(car, name) * max(1.0 + share, LEAST_LEFT) for name, share in shares.items()}
    if "throttle_zero" in shares:
        values["throttle_zero"] = car.throttle_zero + shares["throttle_zero"] * max(car.throttle_zero, LEAST_ZERO)
    moved = {name: getattr(known, name) + off[name] for name in HIDDEN if name in off}
    return car._replace(**values), known._replace(**moved)


def errors(made: Made, model: Array, scale: Array, held: Array) -> Array:
    """Mean square of what is left, a row each, in units of its scale; what nobody can do better counts in both."""
    off = model[held] - made.drive.reports[held][:, ROWS]
    noise = _noise(made.vehicle.noise)
    return ((off**2).mean(axis=0) + scale**2 - noise**2) / scale**2


def scales(made: Made) -> Array:
    """What nobody can do better than, a row each: noise, resolution and a share of what the signal does."""
    floor = OWN_FLOOR + made.vehicle.mismatch
    reports = made.drive.reports[:, ROWS].copy()
    heading = ROWS.index(HEADING)
    n = len(reports)
    reports[:, heading] -= reports[np.arange(n) // BLOCK * BLOCK, heading]
    return np.sqrt(_noise(made.vehicle.noise) ** 2 + (floor * reports.std(axis=0)) ** 2)


def _noise(noise: Noise) -> Array:
    sigma = {1: noise.pedal_frac, 3: noise.pedal_frac, 4: 0.0, 5: noise.steer_rad, 6: noise.speed_mps,
             11: noise.accel_mps2, 12: noise.accel_mps2, 13: noise.yaw_radps, 16: noise.ins_heading_rad,
             17: noise.ins_speed_mps, 19: noise.ins_yaw_radps}  # fmt: skip
    return np.array([np.hypot(sigma[row], 0.29 * RESOLUTION[row]) for row in ROWS])
