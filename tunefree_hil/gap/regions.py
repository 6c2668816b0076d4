"""Where a link is broken: the residual's energy by what the car was doing, against that of the rest of the drive.

Each region's mean square is compared with the others' by drawing whole blocks again and again; over all regions of a
target the share of false finds is held down (Benjamini and Hochberg).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.chain import Opened
from tunefree_hil.gap.work import Work

Array = np.ndarray

DRAWS = 400
RATE = 0.1  # of false finds
LEAST_ROWS = 60
BINS = 3
NARROW = 0.02  # of what a quantity covers: thirds that lie so close are one, as a pedal at rest is noise


class Region(NamedTuple):
    """A range of something the car did. rms: of the residual there, ratio: of mean squares there and elsewhere with its
    95 % interval; bias: mean there; stands_out: whether the ratio is above 1 with all regions asked at once.
    """

    quantity: str
    low: float
    high: float
    rms: float
    bias: float
    ratio: float
    ratio_low: float
    ratio_high: float
    stands_out: bool

    @property
    def words(self) -> str:
        """As a person would say it."""
        if self.quantity in SIDES:
            return SIDES[self.quantity][0 if self.high <= 0.5 else 1]
        return f"{self.quantity} {self.low:.3g} to {self.high:.3g}"


SIDES = {
    "steer side": ("steering to the right", "steering to the left"),
    "steer way": ("steering wheel turning to the right", "steering wheel turning to the left"),
}


def regions(work: Work, target: str, residual: Sequence[Array], seed: int = 1) -> list[Region]:
    """All regions of a target, the ones that stand out first."""
    drives = [work.setting.drives[d] for d in work.drives_of(target)]
    rows, valid, block = work.rows(target), work.seen(target), work.block[target]
    parts = [_quantities(one, at, target) for one, at in zip(drives, rows, strict=True)]
    keep = [v & (b >= 0) for v, b in zip(valid, block, strict=True)]
    values = np.concatenate([r[k] for r, k in zip(residual, keep, strict=True)])
    at = np.concatenate([b[k] for b, k in zip(block, keep, strict=True)])
    found = []
    for name in parts[0]:
        what = np.concatenate([part[name][k] for part, k in zip(parts, keep, strict=True)])
        for low, high in _edges(name, what):
            inside = (what >= low) & (what <= high)
            if LEAST_ROWS <= inside.sum() <= len(inside) - LEAST_ROWS:
                found.append((name, low, high, inside))
    return _judged(found, values, at, seed)


def _quantities(opened: Opened, rows: Array, target: str) -> dict[str, Array]:
    x = opened.inputs
    throttle, brake, steer = x.outputs.T
    work_j = np.cumsum(np.maximum(-x.rate_mps2, 0.0) * x.speed_mps * (brake > np.median(brake) + 0.005)) * x.dt_s
    all_of = {
        "speed (m/s)": x.speed_mps,
        "throttle (duty)": throttle,
        "brake (duty)": brake,
        "steering, either side (rad)": np.abs(steer),
        "steer side": (steer > 0.0).astype(float),
        "steer way": (np.gradient(steer) > 0.0).astype(float),
        "lateral acceleration (m/s2)": np.abs(x.speed_mps * x.yaw_rate_radps),
        "energy braked (J/kg)": work_j,
        "time (s)": np.arange(opened.ticks) * x.dt_s,
    }
    drop = {"throttle": ("brake", "steer", "lateral", "energy"), "brake": ("throttle", "steer", "lateral"),
            "steer": ("throttle", "brake", "energy")}.get(target, ())  # fmt: skip
    return {name: one[rows] for name, one in all_of.items() if not name.startswith(drop)}


def _edges(name: str, what: Array) -> list[tuple[float, float]]:
    if name in SIDES:
        return [(0.0, 0.4), (0.6, 1.0)]
    first, *inner, last = np.quantile(what, np.linspace(0.0, 1.0, BINS + 1)).tolist()
    cuts, least = [first], NARROW * (last - first)
    for cut in inner:
        if cut - cuts[-1] > least and last - cut > least:
            cuts.append(cut)
    return list(pairwise([*cuts, last])) if last > first else []


def _judged(found: list[tuple[str, float, float, Array]], values: Array, at: Array, seed: int) -> list[Region]:
    if not found:
        return []
    chance = np.random.default_rng(seed)
    blocks, index = np.unique(at, return_inverse=True)
    draws = chance.integers(0, len(blocks), (DRAWS, len(blocks)))
    weights = np.stack([np.bincount(one, minlength=len(blocks)) for one in draws])
    square = values * values

    def _summed(at: Array, weights: Array) -> Array:
        return np.bincount(at, weights=weights, minlength=len(blocks))

    some, doubts = [], []
    for name, low, high, inside in found:
        there = [_summed(index, w) for w in (square * inside, inside, square * ~inside, ~inside)]
        drawn = (weights @ there[0]) * np.maximum(weights @ there[3], 1.0)
        drawn = drawn / np.maximum((weights @ there[1]) * (weights @ there[2]), 1e-300)
        ratio = float(square[inside].mean() / max(square[~inside].mean(), 1e-300))
        ends = np.quantile(drawn, [0.025, 0.975])
        doubts.append(float(np.mean(drawn <= 1.0)))
        rms, bias = float(np.sqrt(square[inside].mean())), float(values[inside].mean())
        some.append(Region(name, low, high, rms, bias, ratio, float(ends[0]), float(ends[1]), False))
    order = np.argsort(doubts)
    passed = [k for k, i in enumerate(order) if doubts[i] <= RATE * (k + 1) / len(order)]
    clear = set(order[: passed[-1] + 1].tolist()) if passed else set()
    some = [one._replace(stands_out=i in clear) for i, one in enumerate(some)]
    return sorted(some, key=lambda one: (not one.stands_out, -one.ratio))
