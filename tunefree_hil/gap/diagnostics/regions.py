"""Regions of driving in which a residual is larger than in the rest of the drive.

The mean square of the residual in a range of a driving quantity is compared with the rest by a block bootstrap. The
false discovery rate over all regions is bounded (Benjamini and Hochberg 1995, doi:10.1111/j.2517-6161.1995.tb02031.x).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.estimation.residuals import ResidualModel
from tunefree_hil.gap.measured.chain import MeasuredDrive

Array = np.ndarray


class RegionCriteria(NamedTuple):
    """How regions are cut and tested."""

    n_draws: int = 400  # of the block bootstrap
    # share of the reported regions that may be chance (procedure of Benjamini and Hochberg)
    false_discovery_rate: float = 0.1
    min_rows: int = 60  # inside a region, and outside; with fewer it is not tested
    n_bins: int = 3  # quantile ranges that a quantity is cut into
    min_bin_share: float = 0.02  # least width of a range, of the quantity's span: a pedal at rest varies by its noise


REGION_CRITERIA = RegionCriteria()


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
