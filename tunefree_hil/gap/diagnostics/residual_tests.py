"""Tests of the residuals: which links of the chain are broken, and where and when.

- A link is broken if its residual has a part that some regression explains (lack_of_fit.py), short bursts, or a total
  error that no calibrated model has. Each is compared with the signal and with the sensor's noise.
- Regions (regions.py): ranges of a driving quantity in which the residual is larger than in the rest of the drive.
- Bursts: oscillations and drop-outs that no regression on the commands explains and that a mean over the drive hides.
  The loudest short windows are compared with the median window.
- Shape: delay, gain and bias of the measured signal against the simulated one.

The thresholds are explained in docs/results/criteria.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.diagnostics.lack_of_fit import LackOfFit
from tunefree_hil.gap.diagnostics.regions import Region
from tunefree_hil.gap.estimation.residuals import TargetProperties

Array = np.ndarray


class LinkCriteria(NamedTuple):
    """When a link is broken; shares are of the deviation of the signal unless said otherwise."""

    min_explainable_share: float = 0.05  # of the residual's mean square: a smaller explainable part is noise
    tolerated_share: float = 0.03  # explainable error of a calibrated model
    # A model that missed more on its calibration's holdout may miss as much again, up to twice as much as others do
    max_tolerated_share: float = 0.06
    max_burst_share: float = 0.15  # in the loudest windows; models of vehicles with other tyres and pedals reach 0.13
    max_gross_share: float = 0.25  # total error beyond noise: no calibrated model misses that much
    min_noise_ratio: float = 10.0  # of mean squares, residual to sensor noise: from here on it is not noise


class BurstCriteria(NamedTuple):
    """What a burst is; ratios are of mean squares."""

    window_s: float = 0.5  # half a period at 1 Hz
    loudest_share: float = 0.02  # of the windows: a second in a minute
    min_windows: int = 50  # in all blocks; with fewer no burst is looked for
    min_movement_share: float = 0.05  # of the signal's deviation: a window that moves less has rounding errors only
    min_moving_windows: int = 10  # with fewer the median is that of all windows
    min_loud_ratio: float = 10.0  # of a loud window to the median window
    noise_ratio: float = 5.0  # of the loudest window to the median window, by noise alone
    min_blocks: int = 2  # with loud windows: once may be a pothole


class ShapeCriteria(NamedTuple):
    """From which size on a part of a shape is reported."""

    max_lag_s: float = 0.8  # largest lag that is searched
    min_delay_s: float = 0.01  # from here on a response is reported as late or early
    min_gain_change: float = 0.02  # share by which a gain differs from 1
    min_bias_share: float = 0.02  # of the signal's deviation
    max_gain_change: float = 5.0  # a larger one is reported without its value
    min_rows: int = 256  # valid rows of the longest drive; with fewer no shape is measured


LINK_CRITERIA, BURST_CRITERIA, SHAPE_CRITERIA = LinkCriteria(), BurstCriteria(), ShapeCriteria()


class MisfitKind(Enum):
    """The largest misfit of a link."""

    EXPLAINABLE = "explainable"
    BURSTS = "bursts"
    GROSS = "gross"


TEXTS = {
    MisfitKind.EXPLAINABLE: "{signal} is missed by {share:.1%}",
    MisfitKind.BURSTS: "{signal} is missed by {share:.0%} of the signal in short bursts, and hardly elsewhere",
    MisfitKind.GROSS: "{signal} is missed by {share:.0%} of the signal, and no regression explains most of that",
}


class LinkResidual(NamedTuple):
    """The residual of a target after recalibration.

    Args:
        signal: name of the target.
        link: the link that it belongs to.
        unit: of `rms`, `noise` and `explainable_rms`.
        rms: of the whole residual.
        noise: RMS of the part that nothing explains.
        explainable_rms: of the part that some regression explains.
        explainable_share: `explainable_rms` as a share of the signal's deviation.
        is_broken: whether the link is broken.
        burst_share: error in the loudest windows, share of the signal; 0 where these do not stand out.
        tolerated_share: the explainable share up to which the link is not broken.
        gross_share: total error beyond noise, share of the signal; 0 where it is not far above noise.
    """

    signal: str
    link: Link
    unit: str
    rms: float
    noise: float
    explainable_rms: float
    explainable_share: float
    is_broken: bool
    burst_share: float = 0.0
    tolerated_share: float = LINK_CRITERIA.tolerated_share
    gross_share: float = 0.0

    @property
    def kind(self) -> MisfitKind:
        """What is reported about the residual."""
        if self.burst_share > LINK_CRITERIA.max_burst_share:
            return MisfitKind.BURSTS
        if self.gross_share > max(LINK_CRITERIA.max_gross_share, self.explainable_share):
            return MisfitKind.GROSS
        return MisfitKind.EXPLAINABLE

    @property
    def text(self) -> str:
        """The misfit as a sentence."""
        shares = {MisfitKind.BURSTS: self.burst_share, MisfitKind.GROSS: self.gross_share}
        return TEXTS[self.kind].format(signal=self.signal, share=shares.get(self.kind, self.explainable_share))

    @property
    def misfit_share(self) -> float:
        """Error as a share of the signal: the explainable part, or bursts or total error where these break the link."""
        return max(
            self.explainable_share,
            self.burst_share if self.burst_share > LINK_CRITERIA.max_burst_share else 0.0,
            self.gross_share if self.gross_share > LINK_CRITERIA.max_gross_share else 0.0,
        )


class MisfitDescription(NamedTuple):
    """A broken link with its shape, its regions (those that stand out first), and all that as a text."""

    residual: LinkResidual
    shape: Shape | None
    regions: tuple[Region, ...]
    text: str


def assess_links(
    lack_of_fit: Mapping[str, LackOfFit],
    targets: Mapping[str, TargetProperties],
    sizes: Mapping[str, float],
    bursts: Mapping[str, Burst] | None = None,
) -> list[LinkResidual]:
    """All targets, the broken ones first, of these the largest misfit first.

    Args:
        lack_of_fit: by target.
        targets: by name.
        sizes: by target, deviation of the signal.
        bursts: by target; they do not count for a yaw rate from wheel speeds, in which every bump is loud.
    """
    bursts = bursts or {}
    residuals = [
        _assess_link(name, fit, targets[name], sizes[name], bursts.get(name)) for name, fit in lack_of_fit.items()
    ]
    return sorted(residuals, key=lambda residual: (not residual.is_broken, -residual.misfit_share))


def _assess_link(name: str, fit: LackOfFit, target: TargetProperties, size: float, burst: Burst | None) -> LinkResidual:
    explainable = max(fit.explained, 0.0)
    share = explainable**0.5 / max(size, 1e-12)
    min_blocks = 1 if target.link is Link.COMMAND_TO_REPORT else BURST_CRITERIA.min_blocks
    loud = burst.signal_share(size, min_blocks) if burst is not None and not target.is_yaw_from_wheels else 0.0
    tolerated = min(
        max(LINK_CRITERIA.tolerated_share, target.calibration_misfit / max(size, 1e-12)),
        LINK_CRITERIA.max_tolerated_share,
    )
    is_far = fit.total > LINK_CRITERIA.min_noise_ratio * target.noise**2 and not target.is_yaw_from_wheels
    beyond = fit.total - target.noise**2 if is_far else 0.0
    gross = beyond**0.5 / max(size, 1e-12)
    is_explainable = share > tolerated and explainable > LINK_CRITERIA.min_explainable_share * fit.total
    return LinkResidual(
        signal=name,
        link=target.link,
        unit=target.unit,
        rms=fit.total**0.5,
        noise=max(fit.total - explainable, 0.0) ** 0.5,
        explainable_rms=explainable**0.5,
        explainable_share=share,
        is_broken=loud > LINK_CRITERIA.max_burst_share or gross > LINK_CRITERIA.max_gross_share or is_explainable,
        burst_share=loud,
        tolerated_share=tolerated,
        gross_share=gross,
    )


def describe_misfit(
    residual: LinkResidual, shape: Shape | None, regions: Sequence[Region], size: float
) -> MisfitDescription:
    """A broken link as text, such as 'brake (command_to_report), brake (duty) 0.15 to 0.22, 0.31 s late'.

    size: deviation of the signal.
    """
    clear = [region.text for region in regions if region.stands_out][:2]
    shape_text = "" if shape is None else shape.text(size)
    parts = [f"{residual.signal} ({residual.link.value})", *clear, *([shape_text] if shape_text else [])]
    return MisfitDescription(residual, shape, tuple(regions), ", ".join(parts))


class Burst(NamedTuple):
    """The loudest windows of a residual, in the target's unit.

    Args:
        loud_rms: of the residual in the loudest windows.
        median_rms: of the residual in the median window.
        loud_blocks: number of blocks with loud windows.
        signal_rms: of the measured signal in the loudest windows, about its mean.
    """

    loud_rms: float
    median_rms: float
    loud_blocks: int
    signal_rms: float = 0.0

    def signal_share(self, size: float, min_blocks: int = BURST_CRITERIA.min_blocks) -> float:
        """The error in the loudest windows beyond noise, as a share of the signal; 0 where they do not stand out.

        Args:
            size: deviation of the signal over the drives. Where the signal in the loudest windows is larger, that
                counts: a signal that rests for most of the drives has a small deviation.
            min_blocks: number of blocks with loud windows below which nothing stands out.
        """
        stands_out = (
            self.loud_blocks >= min_blocks and self.loud_rms**2 > BURST_CRITERIA.min_loud_ratio * self.median_rms**2
        )
        beyond = self.loud_rms**2 - BURST_CRITERIA.noise_ratio * self.median_rms**2
        return beyond**0.5 / max(size, self.signal_rms, 1e-12) if stands_out else 0.0


class TargetRows(NamedTuple):
    """The rows of a target, by drive: residual, measured, valid and block, each (n_rows,)."""

    residual: Sequence[Array]
    measured: Sequence[Array]
    valid: Sequence[Array]
    block: Sequence[Array]


def measure_burst(target: TargetRows, blocks: Array, dt_s: float) -> Burst:
    """The loudest windows in `blocks`; all zero where there are too few windows.

    dt_s: time between two rows.
    """
    rows = max(round(BURST_CRITERIA.window_s / dt_s), 1)
    missed, window_block = _join_windows(target.residual, target, rows)
    signal, _ = _join_windows(target.measured, target, rows)
    is_in_blocks = np.isin(window_block, blocks)
    missed, signal, window_block = missed[is_in_blocks], signal[is_in_blocks], window_block[is_in_blocks]
    if len(missed) < BURST_CRITERIA.min_windows:
        return Burst(0.0, 0.0, 0)
    squares = np.mean(missed**2, axis=1)
    is_moving = np.ptp(signal, axis=1) > BURST_CRITERIA.min_movement_share * signal.std()
    median = float(np.median(squares[is_moving] if is_moving.sum() >= BURST_CRITERIA.min_moving_windows else squares))
    loudest = np.argsort(squares)[-max(round(BURST_CRITERIA.loudest_share * len(squares)), 1) :]
    signal_rms = float(np.mean((signal[loudest] - signal.mean()) ** 2)) ** 0.5
    loud_rms = float(squares[loudest].mean()) ** 0.5
    loud_blocks = len(np.unique(window_block[squares > BURST_CRITERIA.min_loud_ratio * median]))
    return Burst(loud_rms, median**0.5, loud_blocks, signal_rms)


def _join_windows(values: Sequence[Array], target: TargetRows, rows: int) -> tuple[Array, Array]:
    """The windows of all drives, (n_windows, rows), and their blocks, (n_windows,)."""
    pieces = [cut_windows(*drive, rows) for drive in zip(values, target.valid, target.block, strict=True)]
    return np.concatenate([windows for windows, _ in pieces]), np.concatenate([block for _, block in pieces])


def cut_windows(values: Array, valid: Array, block: Array, rows: int) -> tuple[Array, Array]:
    """Windows without an invalid row and within one block, (n_windows, rows), and their blocks, (n_windows,)."""
    count = len(values) // rows
    values, valid, block = (array[: count * rows].reshape(count, rows) for array in (values, valid, block))
    is_whole = valid.all(axis=1) & (block == block[:, :1]).all(axis=1) & (block[:, 0] >= 0)
    return values[is_whole], block[is_whole, 0]


class Shape(NamedTuple):
    """The measured signal against the simulated one. The fields are keys of the stored search result.

    Args:
        late_s: delay of the measured signal.
        gain: factor.
        bias: offset, in the signal's unit.
    """

    late_s: float
    gain: float
    bias: float

    def text(self, size: float) -> str:
        """The clear parts of the shape, '' if there are none. size: deviation of the signal."""
        parts = []
        if abs(self.late_s) >= SHAPE_CRITERIA.min_delay_s:
            parts.append(f"{abs(self.late_s):.2f} s {'late' if self.late_s > 0.0 else 'early'}")
        change = abs(self.gain - 1.0)
        if change >= SHAPE_CRITERIA.min_gain_change:
            amount = f"{change:.0%}" if change < SHAPE_CRITERIA.max_gain_change else "much too"
            parts.append(f"{amount} {'strong' if self.gain > 1.0 else 'weak'}")
        if abs(self.bias) >= SHAPE_CRITERIA.min_bias_share * size:
            parts.append(f"{self.bias:+.3g} off")
        return ", ".join(parts)


class _Line(NamedTuple):
    """A straight line through simulated and measured values; squares: sum of the squared errors."""

    gain: float
    bias: float
    squares: float


def fit_shape(
    residual: Sequence[Array], measured: Sequence[Array], valid: Sequence[Array], dt_s: float
) -> Shape | None:
    """The shape of a target in its longest drive; None where that has too few rows.

    Args:
        residual: by drive, simulated minus measured.
        measured: by drive.
        valid: by drive.
        dt_s: time between two rows.
    """
    longest = int(np.argmax([drive.sum() for drive in valid]))
    rows, truth = valid[longest], measured[longest]
    simulated = truth + residual[longest]
    if rows.sum() < SHAPE_CRITERIA.min_rows or np.std(simulated[rows]) < 1e-12:
        return None
    max_lag = round(SHAPE_CRITERIA.max_lag_s / dt_s)
    costs = [_fit_line(np.roll(simulated, lag), truth, rows).squares for lag in range(-max_lag, max_lag + 1)]
    best = int(np.argmin(costs))
    lag = best - max_lag + _parabola_offset(costs, best)
    line = _fit_line(np.roll(simulated, best - max_lag), truth, rows)
    return Shape(lag * dt_s, line.gain, line.bias)


def _fit_line(simulated: Array, truth: Array, rows: Array) -> _Line:
    x, y = simulated[rows], truth[rows]
    dx, dy = x - x.mean(), y - y.mean()
    square = float(dx @ dx)
    gain = float(dx @ dy) / square if square > 0.0 else 1.0
    return _Line(gain, float(y.mean() - gain * x.mean()), float(dy @ dy) - gain * float(dx @ dy))


def _parabola_offset(costs: Sequence[float], best: int) -> float:
    """Where the parabola through three costs has its minimum, in places from `best`."""
    if not 0 < best < len(costs) - 1:
        return 0.0
    a, b, c = costs[best - 1 : best + 2]
    curve = a - 2.0 * b + c
    return 0.5 * (a - c) / curve if curve > 0.0 else 0.0
