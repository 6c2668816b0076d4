"""How much of a residual could still be explained, by anything: the absolute test behind a name.

A model that names no cause (ridge regression on commands, outputs and speed of the last second, with the shapes that
dead bands, gains, lags and side slip have) is fitted to the residual on some blocks and judged on others.
What it finds after a repair is what the repair has left; where that is much of what there was, the name was not it.
Nothing that is compared goes into it, nor what shares its noise: rates of the measured motion foretell themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.chain import Opened
from tunefree_hil.gap.graph import CHANNELS
from tunefree_hil.gap.targets import Target

Array = np.ndarray

LAGS_S = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8)
RIDGES = (1e-3, 1e-2, 1e-1)
FOLDS = 4


class Left(NamedTuple):
    """Mean squares of a target's residual: all of it, and the part that can be foretold on blocks not fitted on."""

    total: float
    explained: float


def features(opened: Opened, target: Target) -> Array:
    """[m, k], each with mean 0 and deviation 1 over the rows that count. Only what was before or now: no future."""
    x = opened.inputs
    lags = [round(lag / opened.dt_s) for lag in LAGS_S]
    if target.name in CHANNELS:
        command = x.commands[:, CHANNELS.index(target.name)]
        signals, still = [command, np.gradient(command), np.abs(command)], []
    else:
        throttle, brake, steer = x.outputs.T
        speed, turning = x.speed_mps, np.gradient(steer)
        still = [speed, speed * speed, 1.0 / np.maximum(speed, 1.0)]
        signals = [throttle, brake, steer, np.abs(steer), speed * steer, speed * speed * steer, steer**3,
                   throttle * speed, throttle**2, brake**2, brake * speed,
                   np.sign(turning) * np.minimum(np.abs(turning) * 1e3, 1.0)]  # fmt: skip
    columns = [np.roll(one, lag)[target.rows] for one in signals for lag in lags]
    columns += [one[target.rows] for one in still]
    rows = np.stack([*columns, np.arange(len(target.rows)) / len(target.rows)], axis=1)
    some = rows[target.valid]
    return (rows - some.mean(axis=0)) / np.maximum(some.std(axis=0), 1e-9)


def left_of(columns: Array, residual: Array, valid: Array, block: Array, blocks: Array) -> Left:
    """How much of a residual is foretold on blocks that were not fitted on. block [m]: of each row."""
    rows = valid & np.isin(block, blocks)
    if rows.sum() < 2 * columns.shape[1]:
        return Left(0.0, 0.0)
    x = np.column_stack([np.ones(rows.sum()), columns[rows]])
    y, at = residual[rows], block[rows]
    fold = np.searchsorted(np.sort(blocks), at) % FOLDS
    total = float(np.mean(y * y))
    best = 0.0
    for ridge in RIDGES:
        missed = 0.0
        for k in range(FOLDS):
            held = fold == k
            gram = x[~held].T @ x[~held] + ridge * (~held).sum() * np.eye(x.shape[1])
            weights = np.linalg.solve(gram, x[~held].T @ y[~held])
            missed += float(np.sum((y[held] - x[held] @ weights) ** 2))
        best = max(best, total - missed / len(y))
    return Left(total, best)


def leftovers(
    drives: Sequence[Opened], targets: Sequence[Sequence[Target]], residuals: dict[str, list[Array]],
    block: dict[str, list[Array]], blocks: Array,
) -> dict[str, Left]:  # fmt: skip
    """By target, over all drives."""
    found: dict[str, list[Left]] = {}
    for opened, some in zip(drives, targets, strict=True):
        for target in some:
            place = len(found.setdefault(target.name, []))
            columns = features(opened, target)
            residual, at = residuals[target.name][place], block[target.name][place]
            found[target.name].append(left_of(columns, residual, target.valid, at, blocks))
    return {
        name: Left(float(np.mean([one.total for one in some])), float(np.mean([one.explained for one in some])))
        for name, some in found.items()
    }
