"""The gap on the holdout blocks: errors by signal, original, recalibrated, repaired and floor, and the share closed.

The floor is the error of a model that lacks nothing: the sensor's noise, and what the calibration missed of drives that
it was not fitted on (the model's card). Beside it, and never part of it, stands the unpredictable part of what the
repaired model misses (gap/diagnostics/lack_of_fit.py). Intervals are bootstraps of whole blocks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.gap.diagnostics.residual_tests import LINK_CRITERIA
from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.measured.observability import OUTPUT_FIELDS
from tunefree_hil.gap.model.card import read_holdout_errors
from tunefree_hil.gap.validation.block_runs import DIVERGED_SQUARE, HEADING, POSITION, UNITS, BlockErrors

Array = np.ndarray

N_DRAWS = 1000  # of the bootstrap
MAX_GROWTH = 0.02  # share of a signal's error that a repair may add
MIN_OPEN_GAP = 0.02  # in units of the floor: if recalibration leaves less, there is no gap
MAX_FACTOR = 1000.0  # largest growth of an error, or misfit as a share of the signal, that is reported
MIN_CLOSED_SHARE = -10.0  # least share that is reported: the gap is eleven times as large, or the run diverges
MAX_IMPROVED_SHARE = 0.8  # of a signal's error: recalibration that leaves less is worth a calibration
DIRECT_SIGNALS = (  # that a free run does not integrate
    "report.throttle_frac",
    "report.brake_frac",
    "report.steer_rad",
    "report.yaw_rate_radps",
    "ins.yaw_rate_radps",
)
CARD_KEYS_BY_SIGNAL = {  # keys of the card's errors in free runs on held-out windows
    "report.speed_mps": ("speed_mps",),
    "ins.speed_mps": ("speed_mps",),
    "report.yaw_rate_radps": ("yaw_rate_radps",),
    "ins.yaw_rate_radps": ("yaw_rate_radps",),
    "report.lateral_accel_mps2": ("lateral_accel_mps2",),
    HEADING: ("heading_rad",),
    POSITION: ("x_m", "y_m"),
}
SPEED_TARGETS, YAW_TARGETS = ("rate_of_speed",), ("steer", "yaw_rate")
TARGETS_BY_SIGNAL = {  # targets whose residual shows how much of a signal is still predictable
    "report.throttle_frac": ("throttle",),
    "report.brake_frac": ("brake",),
    "report.steer_rad": ("steer",),
    "report.speed_mps": (*SPEED_TARGETS, "wheel_vs_ins"),
    "ins.speed_mps": SPEED_TARGETS,
    "report.yaw_rate_radps": (*YAW_TARGETS, "yaw_vs_ins"),
    "ins.yaw_rate_radps": YAW_TARGETS,
    "report.accel_mps2": (*SPEED_TARGETS, "accel_vs_dvdt"),
    "report.lateral_accel_mps2": (*YAW_TARGETS, "lateral_beyond_turning", "lateral_accel"),
    HEADING: YAW_TARGETS,
    POSITION: (*YAW_TARGETS, *SPEED_TARGETS),
}


class SignalGap(NamedTuple):
    """RMS errors of a signal on the holdout; the field names are keys of gap.json's `signals`.

    Args:
        before, recalibrated, after: by variant; None where it was not run.
        floor: the error of a model that lacks nothing.
        unforetold: the unpredictable part of `after`; None where that was not assessed.
    """

    before: float
    recalibrated: float | None
    after: float | None
    floor: float
    unit: str
    unforetold: float | None = None


def error_floors(result: BlockErrors, model: ModelSpec) -> dict[str, float]:
    """By signal: the sensor's noise and the calibration's errors on its own holdout, added in squares."""
    card, floors = read_holdout_errors(model), {}
    actuators = {
        f"report.{OUTPUT_FIELDS[name]}": rms for name, (rms, _) in card.actuators.items() if name in OUTPUT_FIELDS
    }
    for signal in result.counts:
        errors = [card.motion[key] for key in CARD_KEYS_BY_SIGNAL.get(signal, ()) if key in card.motion]
        if signal in actuators:
            errors = [actuators[signal]]
        floors[signal] = math.sqrt(result.noise[signal] ** 2 + sum(error * error for error in errors))
    return floors


def unpredictable_shares(predictable: Mapping[str, float]) -> dict[str, float]:
    """By signal, the share of the repaired model's RMS error that is not predictable; only signals with a target.

    Args:
        predictable: by target (gap/measured/targets.py), the predictable share of the squares. Of several targets of a
            signal the most predictable one counts.
    """
    best = {
        signal: max((predictable[name] for name in targets if name in predictable), default=None)
        for signal, targets in TARGETS_BY_SIGNAL.items()
    }
    return {signal: math.sqrt(1.0 - share) for signal, share in best.items() if share is not None}


def signal_gaps(
    result: BlockErrors, floors: Mapping[str, float], unpredictable: Mapping[str, float]
) -> dict[str, SignalGap]:
    """The errors by signal; a floor is never above what any variant reaches.

    Args:
        unpredictable: of `unpredictable_shares`.
    """
    gaps = {}
    for signal in result.counts:
        rms = {name: result.rms(name, signal) for name in result.squared_errors}
        after = rms.get("after")
        rest = None if after is None or signal not in unpredictable else unpredictable[signal] * after
        floor = min(floors[signal], *rms.values())
        gaps[signal] = SignalGap(rms["before"], rms.get("recalibrated"), after, floor, UNITS[signal], rest)
    return gaps


def closed_share(
    result: BlockErrors, floors: Mapping[str, float], unpredictable: Mapping[str, float] | None = None, seed: int = 1
) -> dict[str, float] | None:
    """(recalibrated - after) / (recalibrated - floor), with its 95 % interval; at least MIN_CLOSED_SHARE.

    A signal's error is in units of its floor: the RMS of each block, its mean over blocks (so that a block in which
    every model is far off does not decide alone), and the RMS over the signals, without heading and position, which are
    sums of the others. A floor is a mean over many drives, so it is compared with the mean and not block by block.

    Args:
        unpredictable: of `unpredictable_shares`: that part counts as floor too. The share is then of what could be
            explained.

    Returns:
        value, low, high; None where recalibration leaves no gap, or no block was run.
    """
    signals = [name for name in result.counts if name not in (HEADING, POSITION) and floors[name] > 0.0]
    if not signals or not result.n_blocks:
        return None
    before, after = (_block_rms(result, name, signals, floors) for name in ("recalibrated", "after"))
    shares = np.array([(unpredictable or {}).get(name, 0.0) for name in signals])
    draws = np.random.default_rng(seed).integers(0, result.n_blocks, (N_DRAWS, result.n_blocks))
    value, open_gap = _closed_above_floor(before, after, shares)
    value = max(value, MIN_CLOSED_SHARE)
    drawn = [_closed_above_floor(before[:, draw], after[:, draw], shares)[0] for draw in draws]
    low, high = np.quantile(drawn, [0.025, 0.975])
    if open_gap <= MIN_OPEN_GAP and value > -MIN_OPEN_GAP:
        return None
    return {"value": value, "low": max(float(low), MIN_CLOSED_SHARE), "high": max(float(high), MIN_CLOSED_SHARE)}


def _closed_above_floor(before: Array, after: Array, unpredictable: Array) -> tuple[float, float]:
    """(closed share of the gap above the floor, the gap in floors). Without a gap the share is of the error.

    Args:
        before, after: errors (n_signals, n_blocks).
        unpredictable: share (n_signals,) of the error that counts as floor too.
    """
    mean_before, mean_after = before.mean(axis=1), after.mean(axis=1)
    reached = np.minimum(mean_before, mean_after)
    least = np.minimum(reached, np.maximum(1.0, unpredictable * reached))
    whole, left, floor = (float(np.sqrt((errors**2).mean())) for errors in (mean_before, mean_after, least))
    open_gap = whole - floor
    return (whole - left) / (open_gap if open_gap > MIN_OPEN_GAP else max(whole, MIN_OPEN_GAP)), open_gap


def _block_rms(result: BlockErrors, variant: str, signals: Sequence[str], floors: Mapping[str, float]) -> Array:
    """RMS (n_signals, n_blocks) in units of the floors; its mean over the other blocks where a signal is missing."""
    rows = []
    for signal in signals:
        counts = result.counts[signal]
        rms = np.sqrt(result.squared_errors[variant][signal] / np.maximum(counts, 1.0)) / floors[signal]
        is_measured = counts > 0.0
        rows.append(np.where(is_measured, rms, rms[is_measured].mean() if is_measured.any() else 0.0))
    return np.stack(rows)


def find_worse_signals(result: BlockErrors, floors: Mapping[str, float], seed: int = 1) -> dict[str, float]:
    """Signals that the repair makes worse by more than MAX_GROWTH, their floor and chance: by how much."""
    rng, worse = np.random.default_rng(seed), {}
    draws = rng.integers(0, max(result.n_blocks, 1), (N_DRAWS, max(result.n_blocks, 1)))
    for signal, counts in result.counts.items():
        before, after = result.squared_errors["before"][signal], result.squared_errors["after"][signal]
        rms_before, rms_after = result.rms("before", signal), result.rms("after", signal)
        if ((after >= DIVERGED_SQUARE) & (before < DIVERGED_SQUARE)).any():  # a run that diverges is no chance
            worse[signal] = MAX_FACTOR
            continue
        if rms_after <= (1.0 + MAX_GROWTH) * rms_before or rms_after <= floors[signal] or not counts.sum():
            continue
        excess = (after - (1.0 + MAX_GROWTH) ** 2 * before)[draws].sum(axis=1)
        if float(np.quantile(excess, 0.025)) > 0.0:
            worse[signal] = min(rms_after / rms_before - 1.0, MAX_FACTOR) if rms_before > 0.0 else MAX_FACTOR
    return worse


def find_grown_signals(result: BlockErrors, floors: Mapping[str, float]) -> dict[str, float]:
    """Signals that are worse by more than MAX_GROWTH and above their floor, by chance or not: by how much."""
    rms = {signal: (result.rms("before", signal), result.rms("after", signal)) for signal in result.counts}
    return {
        signal: min(rms_after / rms_before - 1.0, MAX_FACTOR) if rms_before > 0.0 else MAX_FACTOR
        for signal, (rms_before, rms_after) in rms.items()
        if rms_after > (1.0 + MAX_GROWTH) * rms_before and rms_after > floors[signal]
    }


def find_gross_misses(gaps: Mapping[str, SignalGap], sizes: Mapping[str, float]) -> dict[str, float]:
    """Signals that are missed grossly, far above their floor, even with recalibration: by which share of the signal.

    No calibrated model misses that much (gap/diagnostics/residual_tests.py).

    Args:
        sizes: of the signals to be looked at, the deviation over whole drives.
    """
    gross = {}
    for name, size in sizes.items():
        gap = gaps.get(name)
        if gap is None or size <= 0.0:
            continue
        least = gap.before if gap.recalibrated is None else min(gap.before, gap.recalibrated)
        if least > LINK_CRITERIA.max_gross_share * size and least**2 > LINK_CRITERIA.min_noise_ratio * gap.floor**2:
            gross[name] = min(least / size, MAX_FACTOR)
    return gross


def signal_sizes(drives: Sequence[MeasuredDrive]) -> dict[str, float]:
    """Deviation over all drives of the measured DIRECT_SIGNALS."""
    values: dict[str, list[Array]] = {}
    for drive in drives:
        for name in DIRECT_SIGNALS:
            if drive.has_signals(name) and name not in drive.derived_ticks:
                signal = drive.signals[name]
                values.setdefault(name, []).append(signal.values[signal.fresh & signal.is_valid & drive.is_moving])
    return {name: float(np.std(whole)) for name, parts in values.items() if len(whole := np.concatenate(parts))}


def improved_by_recalibration(gaps: Mapping[str, SignalGap]) -> dict[str, tuple[float, float]]:
    """Signals that recalibration alone takes clearly nearer to the measurement: RMS before and after it."""
    return {
        name: (gap.before, gap.recalibrated)
        for name, gap in gaps.items()
        if gap.recalibrated is not None
        and gap.recalibrated < MAX_IMPROVED_SHARE * gap.before
        and gap.before**2 - gap.recalibrated**2 > gap.floor**2
    }
