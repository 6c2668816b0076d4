"""Tests of the residuals: which links of the chain are broken, and where and when.

- A link is broken if its residual has a part that some regression explains (lack_of_fit.py), short bursts, or a total
  error that no calibrated model has. Each is compared with the signal and with the sensor's noise.
- Regions: the mean square of the residual in a range of a driving quantity, compared with the rest of the drive by a
  block bootstrap. The false discovery rate over all regions is bounded (Benjamini and Hochberg 1995,
  doi:10.1111/j.2517-6161.1995.tb02031.x).
- Bursts: oscillations and drop-outs that no regression on the commands explains and that a mean over the drive hides.
  The loudest short windows are compared with the median window.
- Shape: delay, gain and bias of the measured signal against the simulated one.

The thresholds are explained in docs/results/criteria.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.diagnostics.lack_of_fit import LackOfFit
from tunefree_hil.gap.estimation.residuals import ResidualModel, TargetProperties
from tunefree_hil.gap.measured.chain import MeasuredDrive

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


class RegionCriteria(NamedTuple):
    """How regions are cut and tested."""

    n_draws: int = 400  # of the block bootstrap
    false_discovery_rate: float = 0.1
    min_rows: int = 60  # inside a region, and outside
    n_bins: int = 3
    min_bin_share: float = 0.02  # of the quantity's span: a pedal at rest varies by its noise


class BurstCriteria(NamedTuple):
    """What a burst is; ratios are of mean squares."""

    window_s: float = 0.5  # half a period at 1 Hz
    loudest_share: float = 0.02  # of the windows: a second in a minute
    min_windows: int = 50
    min_movement_share: float = 0.05  # of the signal's deviation: a window that moves less has rounding errors only
    min_moving_windows: int = 10  # with fewer the median is that of all windows
    min_loud_ratio: float = 10.0  # of a loud window to the median window
    noise_ratio: float = 5.0  # of the loudest window to the median window, by noise alone
    min_blocks: int = 2  # with loud windows: once may be a pothole


class ShapeCriteria(NamedTuple):
    """From which size on a part of a shape is reported."""

    max_lag_s: float = 0.8  # searched
    min_delay_s: float = 0.01
    min_gain_change: float = 0.02
    min_bias_share: float = 0.02  # of the signal's deviation
    max_gain_change: float = 5.0  # a larger one is reported without its value
    min_rows: int = 256


LINK_CRITERIA, REGION_CRITERIA, BURST_CRITERIA, SHAPE_CRITERIA = (
    LinkCriteria(),
    RegionCriteria(),
    BurstCriteria(),
    ShapeCriteria(),
)


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
    kinds: Mapping[str, TargetProperties],
    sizes: Mapping[str, float],
    bursts: Mapping[str, Burst] | None = None,
) -> list[LinkResidual]:
    """All targets, the broken ones first, of these the largest misfit first.

    Args:
        lack_of_fit: by target.
        kinds: by target.
        sizes: by target, deviation of the signal.
        bursts: by target; they do not count for a yaw rate from wheel speeds, in which every bump is loud.
    """
    bursts = bursts or {}
    residuals = [
        _assess_link(name, fit, kinds[name], sizes[name], bursts.get(name)) for name, fit in lack_of_fit.items()
    ]
    return sorted(residuals, key=lambda residual: (not residual.is_broken, -residual.misfit_share))


def _assess_link(name: str, fit: LackOfFit, kind: TargetProperties, size: float, burst: Burst | None) -> LinkResidual:
    explainable = max(fit.explained, 0.0)
    share = explainable**0.5 / max(size, 1e-12)
    min_blocks = 1 if kind.link is Link.COMMAND_TO_REPORT else BURST_CRITERIA.min_blocks
    loud = burst.signal_share(size, min_blocks) if burst is not None and not kind.is_yaw_from_wheels else 0.0
    tolerated = min(
        max(LINK_CRITERIA.tolerated_share, kind.calibration_misfit / max(size, 1e-12)),
        LINK_CRITERIA.max_tolerated_share,
    )
    is_far = fit.total > LINK_CRITERIA.min_noise_ratio * kind.noise**2 and not kind.is_yaw_from_wheels
    beyond = fit.total - kind.noise**2 if is_far else 0.0
    gross = beyond**0.5 / max(size, 1e-12)
    is_explainable = share > tolerated and explainable > LINK_CRITERIA.min_explainable_share * fit.total
    return LinkResidual(
        signal=name,
        link=kind.link,
        unit=kind.unit,
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


class Region(NamedTuple):
    """A range of a driving quantity. The fields are keys of the stored search result.

    Args:
        quantity: name, with unit.
        low, high: the range.
        rms: of the residual inside.
        bias: mean of the residual inside.
        ratio: of the mean squares inside and outside.
        ratio_low, ratio_high: 95 % interval of `ratio`.
        stands_out: whether the ratio is above 1, with all regions tested at once.
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
    def text(self) -> str:
        """The range as text."""
        if self.quantity in SIDES:
            return SIDES[self.quantity][0 if self.high <= 0.5 else 1]
        return f"{self.quantity} {self.low:.3g} to {self.high:.3g}"


SIDES = {
    "steer side": ("steering to the right", "steering to the left"),
    "steer way": ("steering wheel turning to the right", "steering wheel turning to the left"),
}
# Beginnings of quantities that say nothing about an actuator
UNRELATED = {
    "throttle": ("brake", "steer", "lateral", "energy"),
    "brake": ("throttle", "steer", "lateral"),
    "steer": ("throttle", "brake", "energy"),
}


class _Bin(NamedTuple):
    """A range before it is tested; is_inside: (n_rows,)."""

    quantity: str
    low: float
    high: float
    is_inside: Array


def find_regions(model: ResidualModel, target: str, residual: Sequence[Array], seed: int = 1) -> list[Region]:
    """The regions of a target, those that stand out first.

    Args:
        model: drives and targets.
        target: name.
        residual: by drive, (n_rows,).
        seed: of the bootstrap.
    """
    drives = [model.spec.drives[i] for i in model.drive_indices(target)]
    rows, valid, block = model.drive_rows(target), model.non_holdout_rows(target), model.target_blocks[target]
    parts = [_region_quantities(drive, drive_rows, target) for drive, drive_rows in zip(drives, rows, strict=True)]
    keep = [v & (b >= 0) for v, b in zip(valid, block, strict=True)]
    values = np.concatenate([r[k] for r, k in zip(residual, keep, strict=True)])
    block_of_row = np.concatenate([b[k] for b, k in zip(block, keep, strict=True)])
    bins = []
    for name in parts[0]:
        quantity = np.concatenate([part[name][k] for part, k in zip(parts, keep, strict=True)])
        for low, high in _bin_edges(name, quantity):
            is_inside = (quantity >= low) & (quantity <= high)
            if REGION_CRITERIA.min_rows <= is_inside.sum() <= len(is_inside) - REGION_CRITERIA.min_rows:
                bins.append(_Bin(name, low, high, is_inside))
    return _test_regions(bins, values, block_of_row, seed)


def _region_quantities(drive: MeasuredDrive, rows: Array, target: str) -> dict[str, Array]:
    """Driving quantities by name, (n_rows,)."""
    x = drive.inputs
    throttle, brake, steer = x.outputs.T
    work_j = np.cumsum(np.maximum(-x.speed_rate_mps2, 0.0) * x.speed_mps * (brake > np.median(brake) + 0.005)) * x.dt_s
    quantities = {
        "speed (m/s)": x.speed_mps,
        "throttle (duty)": throttle,
        "brake (duty)": brake,
        "steering, either side (rad)": np.abs(steer),
        "steer side": (steer > 0.0).astype(float),
        "steer way": (np.gradient(steer) > 0.0).astype(float),
        "lateral acceleration (m/s2)": np.abs(x.speed_mps * x.yaw_rate_radps),
        "energy braked (J/kg)": work_j,
        "time (s)": np.arange(drive.ticks) * x.dt_s,
    }
    unrelated = UNRELATED.get(target, ())
    return {name: values[rows] for name, values in quantities.items() if not name.startswith(unrelated)}


def _bin_edges(name: str, quantity: Array) -> list[tuple[float, float]]:
    """The ranges of a quantity: its two sides, or quantiles that are far enough apart."""
    if name in SIDES:
        return [(0.0, 0.4), (0.6, 1.0)]
    first, *inner, last = np.quantile(quantity, np.linspace(0.0, 1.0, REGION_CRITERIA.n_bins + 1)).tolist()
    edges, min_width = [first], REGION_CRITERIA.min_bin_share * (last - first)
    for edge in inner:
        if edge - edges[-1] > min_width and last - edge > min_width:
            edges.append(edge)
    return list(pairwise([*edges, last])) if last > first else []


def _test_regions(bins: Sequence[_Bin], values: Array, block_of_row: Array, seed: int) -> list[Region]:
    """Bootstrap over blocks, then Benjamini-Hochberg over the bins."""
    if not bins:
        return []
    rng = np.random.default_rng(seed)
    blocks, index = np.unique(block_of_row, return_inverse=True)
    draws = rng.integers(0, len(blocks), (REGION_CRITERIA.n_draws, len(blocks)))
    counts = np.stack([np.bincount(draw, minlength=len(blocks)) for draw in draws])
    square = values * values

    def _sum_by_block(weights: Array) -> Array:
        return np.bincount(index, weights=weights, minlength=len(blocks))

    regions, p_values = [], []
    for name, low, high, is_inside in bins:
        sums = [_sum_by_block(w) for w in (square * is_inside, is_inside, square * ~is_inside, ~is_inside)]
        drawn = (counts @ sums[0]) * np.maximum(counts @ sums[3], 1.0)
        drawn = drawn / np.maximum((counts @ sums[1]) * (counts @ sums[2]), 1e-300)
        ratio = float(square[is_inside].mean() / max(square[~is_inside].mean(), 1e-300))
        ratio_low, ratio_high = (float(end) for end in np.quantile(drawn, [0.025, 0.975]))
        p_values.append(float(np.mean(drawn <= 1.0)))
        rms, bias = float(np.sqrt(square[is_inside].mean())), float(values[is_inside].mean())
        regions.append(Region(name, low, high, rms, bias, ratio, ratio_low, ratio_high, False))
    order = np.argsort(p_values)
    limits = [REGION_CRITERIA.false_discovery_rate * (rank + 1) / len(order) for rank in range(len(order))]
    passed = [rank for rank, i in enumerate(order) if p_values[i] <= limits[rank]]
    standing_out = set(order[: passed[-1] + 1].tolist()) if passed else set()
    regions = [region._replace(stands_out=i in standing_out) for i, region in enumerate(regions)]
    return sorted(regions, key=lambda region: (not region.stands_out, -region.ratio))


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
