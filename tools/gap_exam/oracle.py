"""Whether an effect can be found in a log at all, decided before any answer is opened.

The exam's own car without the effect is recalibrated on every second block (a handful of gains and offsets, tight
priors) and then runs free on the other blocks, restarted from the true state every 8 s; so does the car with the effect
in it. The effect is detectable where the second leaves at least 5 % less of the held-out error than the first.
Errors count in units of what nobody can do better than: noise, the frames' resolution, and half a percent of a signal
(more for a car with background mismatch).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tools.gap_exam.bus import Noise
from tools.gap_exam.car import Car
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
PRIORS = {"drive_n": 0.025, "brake_n": 0.025, "front_stiffness": 0.03, "rear_stiffness": 0.03, "steer_ratio": 0.02,
          "rolling_frac": 0.10, "steer_offset": 0.004}  # fmt: skip
CORRELATED = 60.0  # samples that say one thing
Array = np.ndarray


class Found(NamedTuple):
    """Errors on held-out blocks after recalibration and of the true model; what the latter removes, in all and most."""

    recalibrated: float
    true: float
    removed: float
    most_removed: float
    detectable: bool


def detect(made: Made) -> Found:
    """Decide for a drive that was made. Without any effect nothing is detectable."""
    scale = _scales(made)
    fit, held = _blocks(len(made.drive.commands))
    if made.hidden == NOTHING:
        return Found(1.0, 1.0, 0.0, 0.0, False)
    car = _recalibrated(made, scale, fit)
    before = _errors(made, _free(made, *car), scale, held)
    after = _errors(made, _free(made, made.vehicle.car, made.hidden), scale, held)
    first, last = float(np.sqrt(before.mean())), float(np.sqrt(after.mean()))
    removed, most = 1.0 - last / first, float((1.0 - np.sqrt(after / before)).max())
    return Found(first, last, removed, most, removed >= LEAST)


def _blocks(ticks: int) -> tuple[Array, Array]:
    """Ticks to fit on and to judge by, bool each: blocks in turn, what is at their edges left out."""
    k = np.arange(ticks)
    inside = k % BLOCK >= GUARD
    block = k // BLOCK
    return inside & (block % 2 == 0), inside & (block % 2 == 1)


def _free(made: Made, car: Car, hidden: Hidden) -> Array:
    """Reports [K, rows] of a free run on the recorded commands; heading from the block's start on."""
    restart = np.arange(len(made.drive.commands)) % BLOCK == 0
    lost = made.lost if hidden == made.hidden else np.zeros_like(made.lost)
    run = replay(car, hidden, made.driver, made.drive.commands, made.drive.body, restart, lost)
    return run.reports[:, ROWS]


def _recalibrated(made: Made, scale: Array, fit: Array) -> tuple[Car, Hidden]:
    """Two Gauss-Newton steps from the true constants, without the effect."""
    rows = np.flatnonzero(fit)[::THIN]
    weight = np.sqrt(THIN / CORRELATED) / scale
    names = list(PRIORS)
    at = np.zeros(len(names))

    def residual(x: Array) -> Array:
        off = (_free(made, *_with(made.vehicle.car, dict(zip(names, x, strict=True)))) - made.drive.reports[:, ROWS])[
            rows
        ]
        return (off * weight).clip(-50.0, 50.0).ravel()

    sigma = np.array([PRIORS[name] for name in names])
    for _ in range(2):
        here = residual(at)
        slope = np.stack([(residual(at + 0.2 * s * unit) - here) / (0.2 * s)
                          for s, unit in zip(sigma, np.eye(len(names)), strict=True)], axis=1)  # fmt: skip
        normal = slope.T @ slope + np.diag(1.0 / sigma**2)
        step = np.linalg.solve(normal, -slope.T @ here - at / sigma**2)
        at = np.clip(at + step, -3.0 * sigma, 3.0 * sigma)
    return _with(made.vehicle.car, dict(zip(names, at, strict=True)))


def _with(car: Car, off: dict[str, float]) -> tuple[Car, Hidden]:
    gains = {name: getattr(car, name) * (1.0 + value) for name, value in off.items() if name != "steer_offset"}
    return car._replace(**gains), NOTHING._replace(steer_offset=off.get("steer_offset", 0.0))


def _errors(made: Made, model: Array, scale: Array, held: Array) -> Array:
    """Mean square of what is left, a row each, in units of its scale; what nobody can do better counts in both."""
    off = model[held] - made.drive.reports[held][:, ROWS]
    noise = _noise(made.vehicle.noise)
    return ((off**2).mean(axis=0) + scale**2 - noise**2) / scale**2


def _scales(made: Made) -> Array:
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
