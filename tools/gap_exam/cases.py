"""One question of the exam: which car, which drive, what is hidden. And how its log is made."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tools.gap_exam import bus, drives
from tools.gap_exam.car import Vehicle, draw_vehicle
from tools.gap_exam.catalogue import kind_of, value
from tools.gap_exam.driver import Driver, driver_of
from tools.gap_exam.hidden import Hidden, hidden_of
from tools.gap_exam.seeds import Domain
from tools.gap_exam.simulate import Drive, Plan, drive

Effects = dict[str, dict[str, float]]
MISMATCHES = (0.0, 0.02, 0.0, 0.05)  # of the vehicles of a pool, in turn


class Case(NamedTuple):
    """row: of the issue's table. vehicle, model: numbers of the exam. kind, who: how it is driven. seed: of the drive.

    size: of a row that asks how small an effect may be, else -1. source: of a recording, for rewritten ones. rung,
    place: round of a bisection and place in it (ladder.py); until its turn comes such a case stands at the middle size.
    """

    number: int
    row: str
    vehicle: int
    model: str
    kind: str
    who: int
    effects: Effects
    seed: int
    duration_s: float = 180.0
    size: float = -1.0
    source: str = ""
    rung: int = -1
    place: int = -1


class Made(NamedTuple):
    """A drive with all that made it. lost: ticks whose command frames nobody obeyed."""

    vehicle: Vehicle
    hidden: Hidden
    driver: Driver
    drive: Drive
    lost: np.ndarray


def vehicle_of(domain: Domain, number: int) -> Vehicle:
    """Vehicle `number` of an exam's pool."""
    return draw_vehicle(domain.seed("vehicle", number), MISMATCHES[number % len(MISMATCHES)])


def draw_effect(name: str, rng: np.random.Generator, size: float | None = None) -> dict[str, float]:
    """An effect's parameters between the grid points of anybody: size from 0 to 1, drawn unless it is given."""
    kind = kind_of(name)
    drawn = rng.uniform(0.12, 1.0)
    sign = int(rng.choice((-1, 1))) if kind.signed else 1
    params = {kind.parameter: float(f"{value(name, drawn if size is None else size, sign):.5g}")}
    if kind.second:
        params[kind.second] = round(float(rng.uniform(*kind.second_range)), 3)
    return params


def make(vehicle: Vehicle, effects: Effects, kind: str, who: int, seed: int, duration_s: float = 180.0) -> Made:
    """Drive a car with some effects hidden in it. Plan, driver, noise and stamps depend on the seed alone."""
    hidden = hidden_of(effects)
    plan, noise = planned(vehicle, kind, seed, duration_s)
    driver = driver_of(vehicle, who, np.random.default_rng([seed, 2]))
    lost = lost_frames(hidden, len(noise), np.random.default_rng([seed, 4]))
    return Made(vehicle, hidden, driver, drive(vehicle.car, hidden, plan, driver, noise, lost), lost)


def planned(vehicle: Vehicle, kind: str, seed: int, duration_s: float) -> tuple[Plan, np.ndarray]:
    """What a drive's driver wants, and the noise on its reports [K, 20]."""
    plan: Plan = drives.KINDS[kind](vehicle, duration_s, np.random.default_rng([seed, 1]))
    return plan, bus.noise_rows(vehicle.noise, len(plan.speed_mps), np.random.default_rng([seed, 3]))


def log_of(made: Made, seed: int) -> str:
    """The log's text."""
    return bus.log_text(made.drive, made.vehicle.car.rest_frac, np.random.default_rng([seed, 5]))


def lost_frames(hidden: Hidden, ticks: int, rng: np.random.Generator) -> np.ndarray:
    """Ticks whose command frames are lost between the log and the by-wire unit, in bursts; bool [ticks]."""
    lost = np.zeros(ticks, dtype=bool)
    if hidden.frame_loss > 0.0:
        for start in np.flatnonzero(rng.random(ticks) < 0.01 * hidden.frame_loss_bursts_per_s):
            lost[start : start + max(1, round(100.0 * hidden.frame_loss * rng.uniform(0.5, 1.5)))] = True
    return lost
