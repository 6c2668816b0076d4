"""How much of a residual could still be explained, by anything: the absolute test behind a name.

A model that names no cause (ridge regression on commands, outputs and speed of the last 0.8 s, with the shapes that
dead bands, gains, lags and side slip have) is fitted to the residual on some blocks and judged on others.
What it finds after a repair is what the repair has left; where that is much of what there was, the name was not it.
Nothing that is compared goes into it, nor what shares its noise: rates of the measured motion foretell themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.measured.targets import Target
from tunefree_hil.gap.model.graph import CHANNELS
from tunefree_hil.gap.model.history import ahead

Array = np.ndarray

LEAST_MPS = 1.0  # of a road car (gap/measured/chain.py `pace_of`): slower, one over the speed says nothing more
CLEARLY_TURNING = 0.0125  # of the greatest angle, per s: which way the wheel turns is known from there on
LAGS_S = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8)
FEWER_LAGS_S = ((0.0, 0.1, 0.4), (0.0, 0.2), (0.0,))  # where rows are few
ENOUGH_ROWS = 10  # a column: of less, the weights are noise, and what a residual holds is not seen
RIDGES = (1e-3, 1e-2, 1e-1)
FOLDS = 4


class Left(NamedTuple):
    """Mean squares of a target's residual: all of it, and the part that can be foretold on blocks not fitted on."""

    total: float
    explained: float


class Piece(NamedTuple):
    """One drive's part of a target: columns [m, k] as they are, residual [m], rows that count [m], block [m]."""

    columns: Array
    residual: Array
    valid: Array
    block: Array


def features(opened: Opened, target: Target, lags_s: Sequence[float] = LAGS_S) -> Array:
    """[m, k] at the rows of a target. Only what was before or now: no future."""
    x = opened.inputs
    lags = [lag / opened.dt_s for lag in lags_s]
    if target.name in CHANNELS:
        command = x.commands[:, CHANNELS.index(target.name)]
        signals, still = [command, _change(command), np.abs(command)], []
    else:
        throttle, brake, steer = x.outputs.T
        speed, turning = x.speed_mps, _change(steer)
        still = [speed, speed * speed, 1.0 / np.maximum(speed, LEAST_MPS * opened.pace)]
        signals = [throttle, brake, steer, np.abs(steer), speed * steer, speed * speed * steer, steer**3,
                   throttle * speed, throttle**2, brake**2, brake * speed,
                   np.clip(turning / (CLEARLY_TURNING * opened.most_steer_rad * opened.dt_s), -1.0, 1.0)]  # fmt: skip
    columns = [ahead(one, -round(lag))[target.rows] for one in signals for lag in lags]
    columns += [one[target.rows] for one in still]
    return np.stack([*columns, np.arange(len(target.rows)) / len(target.rows)], axis=1)


def _change(signal: Array) -> Array:
    """Since the tick before."""
    return np.diff(signal, prepend=signal[:1])


def left_of(columns: Array, residual: Array, valid: Array, block: Array, blocks: Array) -> Left:
    """How much of a residual is foretold on blocks that were not fitted on. block [m]: of each row. Nothing is foretold
    of too few rows, or where all are of blocks that are held out together; what is missed there is missed all the same.
    """
    rows = valid & np.isin(block, blocks)
    if not rows.any():
        return Left(0.0, 0.0)
    total = float(np.mean(residual[rows] ** 2))
    if rows.sum() < 2 * columns.shape[1]:
        return Left(total, 0.0)
    x = np.column_stack([np.ones(rows.sum()), columns[rows]])
    y, at = residual[rows], block[rows]
    fold = np.searchsorted(np.sort(blocks), at) % FOLDS
    if len(np.unique(fold)) < 2:
        return Left(total, 0.0)
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


def left_over_all(pieces: Sequence[Piece], blocks: Array) -> Left:
    """Of all drives together: what foretells is the same in all of them, but for a constant of each. Every row counts
    as much as any other, whichever drive it is of.
    """
    valid = np.concatenate([one.valid for one in pieces])
    columns = np.concatenate([one.columns for one in pieces])
    if len(pieces) > 1:
        drive = np.repeat(np.arange(len(pieces)), [len(one.valid) for one in pieces])
        columns = np.column_stack([columns, drive[:, None] == np.arange(len(pieces))])
    if not valid.any():
        return Left(0.0, 0.0)
    some = columns[valid]
    even = (columns - some.mean(axis=0)) / np.maximum(some.std(axis=0), 1e-9)
    residual, block = (np.concatenate([one[i] for one in pieces]) for i in (1, 3))
    return left_of(even, residual, valid, block, blocks)


def leftovers(
    drives: Sequence[Opened], targets: Sequence[Sequence[Target]], residuals: dict[str, list[Array]],
    block: dict[str, list[Array]], blocks: Array,
) -> dict[str, Left]:  # fmt: skip
    """By target, over all drives; by as many lags as their rows bear."""
    mine: dict[str, list[tuple[Opened, Target]]] = {}
    for opened, some in zip(drives, targets, strict=True):
        for target in some:
            mine.setdefault(target.name, []).append((opened, target))
    found = {}
    for name, some in mine.items():
        judged = [target.valid & np.isin(at, blocks) for (_, target), at in zip(some, block[name], strict=True)]
        pieces = _pieces(some, residuals[name], block[name], sum(int(rows.sum()) for rows in judged))
        found[name] = left_over_all(pieces, blocks)
    return found


def _pieces(
    some: Sequence[tuple[Opened, Target]], residuals: Sequence[Array], block: Sequence[Array], rows: int
) -> list[Piece]:
    """The drives of a target, with all lags of which `rows` bear the columns."""
    columns = [features(*one) for one in some]
    for lags_s in FEWER_LAGS_S:
        if rows >= ENOUGH_ROWS * columns[0].shape[1]:
            break
        columns = [features(*one, lags_s) for one in some]
    valid = [target.valid for _, target in some]
    return [Piece(*one) for one in zip(columns, residuals, valid, block, strict=True)]
