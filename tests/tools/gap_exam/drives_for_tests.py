"""One car and one drive of it, with and without something hidden, and what a signal must look like then."""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np

from tools.gap_exam import cases
from tools.gap_exam.car import Vehicle
from tools.gap_exam.cases import Made
from tools.gap_exam.catalogue import kind_of
from tools.gap_exam.driver import CONTROLLER
from tools.gap_exam.hidden import Hidden, hidden_of
from tools.gap_exam.seeds import Domain
from tools.gap_exam.simulate import Drive, replay

DOMAIN = Domain("dev", "tests")
SECONDS = 60.0
TICK_S = 0.01


@cache
def vehicle(number: int = 0) -> Vehicle:
    """Vehicle 0 has no background mismatch, vehicle 3 the most."""
    return cases.vehicle_of(DOMAIN, number)


@cache
def clean(number: int = 0, kind: str = "excited") -> Made:
    """An effect-free drive."""
    return cases.make(vehicle(number), {}, kind, CONTROLLER, DOMAIN.seed("clean", number), SECONDS)


def same_commands(effects: dict[str, dict[str, float]], number: int = 0) -> tuple[Drive, Drive]:
    """(without, with): two free runs without noise on the commands of the clean drive."""
    made = clean(number)
    none = np.zeros(len(made.drive.commands), dtype=bool)
    runs = [
        replay(made.vehicle.car, hidden_of(what), made.driver, made.drive.commands, made.drive.body, none, none)
        for what in ({}, effects)
    ]
    return runs[0], runs[1]


def hidden(**effects: float) -> Hidden:
    """Main parameters by effect."""
    return hidden_of({name: {kind_of(name).parameter: value} for name, value in effects.items()})


def runs(**effects: float) -> tuple[np.ndarray, np.ndarray]:
    """Reports [K, 20] on the same commands, without and with."""
    without, with_it = same_commands({name: {kind_of(name).parameter: value} for name, value in effects.items()})
    return without.reports, with_it.reports


def shifted(x: np.ndarray, delay_s: float) -> np.ndarray:
    """A signal that much later."""
    k = np.arange(len(x))
    return np.interp(k - delay_s / TICK_S, k, x)


def softened(x: np.ndarray, tau_s: float) -> np.ndarray:
    """A first-order lag of a straight-lined signal, exact between ticks."""
    share, y = math.exp(-TICK_S / tau_s), [x[0]]
    for before, now in itertools.pairwise(x):
        slope = (now - before) / TICK_S
        y.append(now - slope * tau_s + (y[-1] - before + slope * tau_s) * share)
    return np.array(y)
