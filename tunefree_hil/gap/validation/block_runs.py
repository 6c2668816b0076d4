"""Free runs of the whole vehicle over blocks of a recording: of the holdout, of the selection, or of an older log.

Before a block the chassis is set to the measured motion; within it the vehicle gets the recorded commands alone. Blocks
of the holdout have been in no fit and no choice. A block has at least 8 s, less where the logs are short
(gap/measured/blocks.py). Errors are RMS by signal; gap_closed.py interprets them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.config.schema import EffectSpec, ModelSpec, VehicleSpec
from tunefree_hil.gap.measured.blocks import HOLDOUT
from tunefree_hil.gap.measured.chain import MeasuredDrive, is_replayable
from tunefree_hil.gap.measured.holdout_assignment import assign_holdout_blocks
from tunefree_hil.gap.measured.observability import OUTPUT_FIELDS
from tunefree_hil.gap.measured.targets import STEERING
from tunefree_hil.gap.validation.free_run import assemble_car, measured_pose, simulate_recording
from tunefree_hil.learn.evaluation.motion import wrap_angle

Array = np.ndarray

POSITION, HEADING = "position_m", "ins.heading_rad"
MAX_SIGNAL = 1e12  # beyond any signal of a vehicle: a run that reaches more, or NaN, has diverged
DIVERGED_SQUARE = 1e30  # sum of squares of such a run in a block: finite, and more than any other's
UNITS = {
    "report.throttle_frac": "1",
    "report.brake_frac": "1",
    "report.steer_rad": "rad",
    "report.speed_mps": "m/s",
    "report.yaw_rate_radps": "rad/s",
    "report.accel_mps2": "m/s2",
    "report.lateral_accel_mps2": "m/s2",
    "ins.speed_mps": "m/s",
    "ins.yaw_rate_radps": "rad/s",
    HEADING: "rad",
    POSITION: "m",
}
LONGITUDINAL_SIGNALS = ("report.speed_mps", "report.accel_mps2", "ins.speed_mps")  # hardly depend on the steering


class Variant(NamedTuple):
    """A vehicle to be run: a model, and effects of the day after its own."""

    model: ModelSpec
    day_effects: tuple[EffectSpec, ...] = ()


class BlockErrors(NamedTuple):
    """Errors of free runs over blocks.

    Args:
        squared_errors: by variant and signal, sums over each block (n_blocks,).
        counts: by signal, rows in each block (n_blocks,).
        noise: by signal, RMS of the sensor's noise over the rows that count.
        traces: of all blocks, for figures; the one in which the variants differ most comes first.
    """

    squared_errors: Mapping[str, Mapping[str, Array]]
    counts: Mapping[str, Array]
    noise: Mapping[str, float]
    traces: tuple[BlockTrace, ...]

    @property
    def n_blocks(self) -> int:
        """Number of blocks that were run."""
        return max((len(rows) for rows in self.counts.values()), default=0)

    def rms(self, variant: str, signal: str) -> float:
        """RMS error of a signal over all blocks."""
        return math.sqrt(float(self.squared_errors[variant][signal].sum()) / max(float(self.counts[signal].sum()), 1.0))


class BlockTrace(NamedTuple):
    """One block: time since its begin; measured values by signal, simulated ones by variant and signal."""

    time_s: Array
    measured: Mapping[str, Array]
    simulated: Mapping[str, Mapping[str, Array]]


def run_blocks(
    variants: Mapping[str, Variant],
    vehicle: VehicleSpec,
    drives: Sequence[MeasuredDrive],
    *,
    role: int | None = HOLDOUT,
    skip_forgotten: bool = False,
) -> BlockErrors:
    """Run all variants over the blocks of a role.

    Args:
        role: of gap/measured/blocks.py; None: all blocks, of recordings that nothing was fitted on.
        skip_forgotten: do not simulate what lies far before a block, of vehicles that forget it (free_run.py).
    """
    blocks = assign_holdout_blocks(drives)
    is_run = np.ones(blocks.count, dtype=bool) if role is None else blocks.roles == role
    sums = _ErrorSums({name: {} for name in variants}, {}, {})
    traces: list[BlockTrace] = []
    signals = [name for name in UNITS if any(_can_compare(drive, name) for drive in drives)]
    for number, drive in enumerate(drives):
        spans = [
            (int(blocks.begins[b]), int(blocks.ends[b]))
            for b in np.flatnonzero((blocks.drives == number) & is_run)
            if is_replayable(drive, slice(blocks.begins[b], blocks.ends[b]))
        ]
        if not spans:
            continue
        simulated = {
            name: _run_variant(variant, vehicle, drive, spans, skip_forgotten=skip_forgotten)
            for name, variant in variants.items()
        }
        for signal in signals:
            _add_errors(sums, signal, drive, simulated, spans)
        traces += [_trace_block(drive, simulated, span) for span in spans]
    return BlockErrors(
        {name: {signal: np.array(values) for signal, values in s.items()} for name, s in sums.squares.items()},
        {signal: np.array(values) for signal, values in sums.counts.items()},
        {signal: math.sqrt(square / max(sum(sums.counts[signal]), 1.0)) for signal, square in sums.noise.items()},
        tuple(sorted(traces, key=_trace_spread, reverse=True)),
    )


class _ErrorSums(NamedTuple):
    """Sums under way: squared errors by variant and signal, rows by signal, squared noise by signal."""

    squares: dict[str, dict[str, list[float]]]
    counts: dict[str, list[float]]
    noise: dict[str, float]


def _add_errors(
    sums: _ErrorSums,
    signal: str,
    drive: MeasuredDrive,
    simulated: Mapping[str, Mapping[str, Array]],
    spans: Sequence[tuple[int, int]],
) -> None:
    """Add a signal's errors in each block of a drive."""
    is_compared, noise = _compared_rows(drive, signal), _sensor_noise(drive, signal)
    for begin, end in spans:
        rows = begin + np.flatnonzero(is_compared[begin:end])
        sums.counts.setdefault(signal, []).append(float(len(rows)))
        sums.noise[signal] = sums.noise.get(signal, 0.0) + len(rows) * noise * noise
        for name, squares in sums.squares.items():
            errors = _errors(signal, simulated[name], drive, rows, begin)
            squares.setdefault(signal, []).append(_sum_of_squares(errors))


def _run_variant(
    variant: Variant,
    vehicle: VehicleSpec,
    drive: MeasuredDrive,
    spans: Sequence[tuple[int, int]],
    *,
    skip_forgotten: bool,
) -> dict[str, Array]:
    """A variant's signals, simulated freely in the blocks."""
    held = np.ones(drive.ticks, dtype=bool)
    for begin, end in spans:
        held[begin:end] = False
    car = assemble_car(variant.model, vehicle, drive, variant.day_effects)
    signals = simulate_recording(car, drive, held, skip_forgotten=skip_forgotten)
    return {name: np.where(np.abs(values) < MAX_SIGNAL, values, np.nan) for name, values in signals.items()}


def _sum_of_squares(errors: Array) -> float:
    """Sum of squares; DIVERGED_SQUARE of a run that diverged, so that it is worse than any other."""
    square = float(errors @ errors)
    return square if math.isfinite(square) else DIVERGED_SQUARE


def _can_compare(drive: MeasuredDrive, signal: str) -> bool:
    """Whether a signal was measured, and enough is known of pedals and steering to simulate it."""
    hidden = drive.unknown_channels - STEERING if signal in LONGITUDINAL_SIGNALS else drive.unknown_channels
    if hidden and not signal.endswith(tuple(OUTPUT_FIELDS.values())):
        return False
    return drive.has_signals("ins.x_m", "ins.y_m") if signal == POSITION else drive.has_signals(signal)


def _compared_rows(drive: MeasuredDrive, signal: str) -> Array:
    """Rows (n_rows,), bool, in which a signal was measured; none where the drive does not have it."""
    if not _can_compare(drive, signal):
        return np.zeros(drive.ticks, dtype=bool)
    measured = drive.signals["ins.x_m" if signal == POSITION else signal]
    return measured.fresh & measured.is_valid


def _sensor_noise(drive: MeasuredDrive, signal: str) -> float:
    """Standard deviation of a sensor's noise; what is counted from the block's begin has that row's noise too."""
    if not _can_compare(drive, signal):
        return 0.0
    measured = drive.signals["ins.x_m" if signal == POSITION else signal]
    return measured.noise * {HEADING: math.sqrt(2.0), POSITION: 2.0}.get(signal, 1.0)


def _errors(signal: str, simulated: Mapping[str, Array], drive: MeasuredDrive, rows: Array, begin: int) -> Array:
    """Errors at some rows of a block. Heading and position are counted from the block's begin."""
    if not len(rows):
        return np.zeros(0)
    if signal == POSITION:
        x, y, _ = measured_pose(drive)
        east, north = simulated["ins.x_m"][rows] - x[rows], simulated["ins.y_m"][rows] - y[rows]
        return np.hypot(
            east - (simulated["ins.x_m"][begin] - x[begin]), north - (simulated["ins.y_m"][begin] - y[begin])
        )
    measured = drive.signals[signal]
    errors = measured.sample_at(simulated[signal], rows) - measured.received[rows]
    return wrap_angle(errors - (simulated[signal][begin] - measured.values[begin])) if signal == HEADING else errors


def _trace_block(
    drive: MeasuredDrive, simulated: Mapping[str, Mapping[str, Array]], span: tuple[int, int]
) -> BlockTrace:
    cut = slice(*span)
    names = [name for name in UNITS if name in drive.signals and _can_compare(drive, name)]
    return BlockTrace(
        np.arange(span[1] - span[0]) * drive.dt_s,
        {name: drive.signals[name].values[cut] for name in names},
        {variant: {name: signals[name][cut] for name in names} for variant, signals in simulated.items()},
    )


def _trace_spread(trace: BlockTrace) -> float:
    """Mean squared difference of the first and the last variant in a block, in units of the signals' deviations."""
    variants = list(trace.simulated)
    first, last = trace.simulated[variants[0]], trace.simulated[variants[-1]]
    deviations = {name: max(float(np.std(values)), 1e-9) for name, values in trace.measured.items() if name != HEADING}
    differences = {name: np.nan_to_num(first[name] - last[name], nan=MAX_SIGNAL) for name in deviations}
    return sum(float(np.mean(differences[name] ** 2)) / size**2 for name, size in deviations.items())
