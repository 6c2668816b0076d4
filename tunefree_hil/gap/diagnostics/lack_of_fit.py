"""How much of a residual a regression without any physical cause can explain: the absolute test behind a verdict.

Ridge regression on commands, outputs and speed of the last 0.8 s, and on the shapes that dead bands, gains, lags and
side slip have. It is fitted on some blocks and judged on others. What it still explains after a repair is the repair's
lack of fit. The measured motion is no feature: its rates share the noise of the targets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.measured.targets import Target
from tunefree_hil.gap.model.graph import CHANNELS
from tunefree_hil.gap.model.history import shift_earlier

Array = np.ndarray


class RegressionCriteria(NamedTuple):
    """Settings of the regression."""

    min_speed_mps: float = 1.0  # of a road car: 1/speed grows no further below it
    # of the greatest steering angle, 1/s: from here on the direction of turning is clear
    clear_turn_rate: float = 0.0125
    lags_s: tuple[float, ...] = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8)  # ages of the inputs that are features of a residual
    # tried in turn where rows are few
    shorter_lags_s: tuple[tuple[float, ...], ...] = ((0.0, 0.1, 0.4), (0.0, 0.2), (0.0,))
    min_rows_per_column: int = 10  # rows per feature; with fewer the weights are noise
    # penalties that are tried, of the row count, for features of unit deviation
    ridges: tuple[float, ...] = (1e-3, 1e-2, 1e-1)
    n_folds: int = 4  # of the cross-validation over blocks


REGRESSION = RegressionCriteria()


class LackOfFit(NamedTuple):
    """Mean squares of a residual: all of it, and the part that is explained on blocks not fitted on."""

    total: float
    explained: float


class RegressionData(NamedTuple):
    """A target in one drive. features: (n_rows, n_features); residual, valid, block: (n_rows,)."""

    features: Array
    residual: Array
    valid: Array
    block: Array


class _DriveTarget(NamedTuple):
    drive: MeasuredDrive
    target: Target


def measure_lack_of_fit(
    drives: Sequence[MeasuredDrive],
    targets: Sequence[Sequence[Target]],
    residuals: Mapping[str, Sequence[Array]],
    block: Mapping[str, Sequence[Array]],
    blocks: Array,
) -> dict[str, LackOfFit]:
    """The lack of fit of each target over all drives, with as many lags as there are rows for.

    Args:
        drives: the measured drives.
        targets: by drive.
        residuals: by target, then by drive that has it: (n_rows,).
        block: the same, the block of each row.
        blocks: the blocks to use.
    """
    by_name: dict[str, list[_DriveTarget]] = {}
    for drive, drive_targets in zip(drives, targets, strict=True):
        for target in drive_targets:
            by_name.setdefault(target.name, []).append(_DriveTarget(drive, target))
    fits = {}
    for name, parts in by_name.items():
        used = [part.target.valid & np.isin(rows, blocks) for part, rows in zip(parts, block[name], strict=True)]
        data = _build_data(parts, residuals[name], block[name], sum(int(rows.sum()) for rows in used))
        fits[name] = pool_lack_of_fit(data, blocks)
    return fits


def build_features(drive: MeasuredDrive, target: Target, lags_s: Sequence[float] = REGRESSION.lags_s) -> Array:
    """Features at the rows of a target, (n_rows, n_features), of the present and the past only."""
    x = drive.inputs
    lags = [lag / drive.dt_s for lag in lags_s]
    if target.name in CHANNELS:
        command = x.commands[:, CHANNELS.index(target.name)]
        lagged, present = [command, _tick_difference(command), np.abs(command)], []
    else:
        throttle, brake, steer = x.outputs.T
        speed, turning = x.speed_mps, _tick_difference(steer)
        present = [speed, speed * speed, 1.0 / np.maximum(speed, REGRESSION.min_speed_mps * drive.size_scale)]
        lagged = [
            throttle,
            brake,
            steer,
            np.abs(steer),
            speed * steer,
            speed * speed * steer,
            steer**3,
            throttle * speed,
            throttle**2,
            brake**2,
            brake * speed,
            np.clip(turning / (REGRESSION.clear_turn_rate * drive.max_steer_rad * drive.dt_s), -1.0, 1.0),
        ]
    columns = [shift_earlier(signal, -round(lag))[target.rows] for signal in lagged for lag in lags]
    columns += [signal[target.rows] for signal in present]
    return np.stack([*columns, np.arange(len(target.rows)) / len(target.rows)], axis=1)


def _tick_difference(signal: Array) -> Array:
    return np.diff(signal, prepend=signal[:1])


def cross_validate(data: RegressionData, blocks: Array) -> LackOfFit:
    """The lack of fit by regression on some of `blocks`, judged on the others.

    Nothing is explained where there are too few rows, or rows of one fold only.
    """
    rows = data.valid & np.isin(data.block, blocks)
    if not rows.any():
        return LackOfFit(0.0, 0.0)
    total = float(np.mean(data.residual[rows] ** 2))
    if rows.sum() < 2 * data.features.shape[1]:
        return LackOfFit(total, 0.0)
    x = np.column_stack([np.ones(rows.sum()), data.features[rows]])
    y, block = data.residual[rows], data.block[rows]
    fold = np.searchsorted(np.sort(blocks), block) % REGRESSION.n_folds
    if len(np.unique(fold)) < 2:
        return LackOfFit(total, 0.0)
    best = 0.0
    for ridge in REGRESSION.ridges:
        missed = 0.0
        for k in range(REGRESSION.n_folds):
            judged = fold == k
            gram = x[~judged].T @ x[~judged] + ridge * (~judged).sum() * np.eye(x.shape[1])
            weights = np.linalg.solve(gram, x[~judged].T @ y[~judged])
            missed += float(np.sum((y[judged] - x[judged] @ weights) ** 2))
        best = max(best, total - missed / len(y))
    return LackOfFit(total, best)


def pool_lack_of_fit(pieces: Sequence[RegressionData], blocks: Array) -> LackOfFit:
    """The lack of fit over several drives: common weights, a constant for each drive, every row counts the same."""
    valid = np.concatenate([piece.valid for piece in pieces])
    features = np.concatenate([piece.features for piece in pieces])
    if len(pieces) > 1:
        drive = np.repeat(np.arange(len(pieces)), [len(piece.valid) for piece in pieces])
        features = np.column_stack([features, drive[:, None] == np.arange(len(pieces))])
    if not valid.any():
        return LackOfFit(0.0, 0.0)
    used = features[valid]
    scaled = (features - used.mean(axis=0)) / np.maximum(used.std(axis=0), 1e-9)
    residual = np.concatenate([piece.residual for piece in pieces])
    block = np.concatenate([piece.block for piece in pieces])
    return cross_validate(RegressionData(scaled, residual, valid, block), blocks)


def _build_data(
    parts: Sequence[_DriveTarget], residuals: Sequence[Array], block: Sequence[Array], n_rows: int
) -> list[RegressionData]:
    """The data of a target by drive, with the most lags that `n_rows` usable rows allow."""
    features = [build_features(*part) for part in parts]
    for lags_s in REGRESSION.shorter_lags_s:
        if n_rows >= REGRESSION.min_rows_per_column * features[0].shape[1]:
            break
        features = [build_features(*part, lags_s) for part in parts]
    valid = [part.target.valid for part in parts]
    return [RegressionData(*piece) for piece in zip(features, residuals, valid, block, strict=True)]
