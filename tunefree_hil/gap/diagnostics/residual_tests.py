"""Where simulation and measurement part: every link by itself, before anybody is suspected.

A link is broken where more is left of it than recalibration takes away, than noise, and than a calibrated model may
miss: what could be explained by *something* on blocks that were not fitted on (leftover.py). A card says it in words.

Where a link is broken: the residual's energy by what the car was doing, against that of the rest of the drive.

Each region's mean square is compared with the others' by drawing whole blocks again and again; over all regions of a
target the share of false finds is held down (Benjamini and Hochberg).

Misses that are loud for a moment and calm else: oscillations, holes, whatever comes and goes by itself.

A regression on commands foretells nothing of them (leftover.py), and the mean over a drive hides them. A drive is cut
into windows; the loudest few are held against the ordinary one in which the signal moves, which is the sensor's noise
and what a model misses everywhere, and against the signal. Who explains a drive but for such moments has not found
what makes them.

What a residual looks like, for people: how late the car is, how weak, and how far off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.diagnostics.lack_of_fit import Left
from tunefree_hil.gap.estimation.residuals import Kind, Work
from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.measured.clock import Echo

LEAST_SHARE = 0.05  # of a target's mean square that something could explain
VISIBLE = 0.03  # of the signal: what a calibrated model may miss of a car
# Where its own calibration missed more of drives that it was not fitted on, that; but a model that misses twice as much
# as others do lacks something itself
MOST_VISIBLE = 0.06
LOUD = 0.15  # of the signal, in the loudest moments: of cars with other tyres and pedals up to 0.13 is missed
# Of the signal, beyond the sensor's noise and far above it (squares): so much is missed of no car that anybody has
# calibrated, whether it can be foretold or not
GROSS, FAR = 0.25, 10.0
NO_BURSTS: Mapping[str, Burst] = {}


class Looked(NamedTuple):
    """One target of a link with recalibration done. rms: left; noise: of it what nothing explains; explicable: what
    something could, and as a share of the signal it is about. loud: what the loudest moments miss of the signal, where
    they are far above the ordinary (gap/diagnostics/residual_tests.py); else 0. visible: of the signal, what no link is broken by.
    """

    signal: str
    link: Link
    unit: str
    rms: float
    noise: float
    explicable: float
    share: float
    broken: bool
    loud: float = 0.0
    visible: float = VISIBLE
    gross: float = 0.0

    @property
    def missed(self) -> str:
        """What is broken about it, in words."""
        if self.loud > LOUD:
            return f"{self.signal} is missed by {self.loud:.0%} of the signal in moments, and hardly else"
        if self.gross > max(GROSS, self.share):
            return (
                f"{self.signal} is missed by {self.gross:.0%} of the signal, and little of that is foretold by anything"
            )
        return f"{self.signal} is missed by {self.share:.1%}"

    @property
    def amount(self) -> float:
        """Of the signal, what is missed: what could be explained, what its moments miss where they are loud, or all
        where that is gross.
        """
        return max(self.share, self.loud if self.loud > LOUD else 0.0, self.gross if self.gross > GROSS else 0.0)


class Card(NamedTuple):
    """A broken target in words, with its shape and the regions it was looked at in, those that stand out first."""

    looked: Looked
    shape: Shape | None
    regions: tuple[Region, ...]
    words: str


def look(
    left: Mapping[str, Left], kinds: Mapping[str, Kind], sizes: Mapping[str, float],
    bursts: Mapping[str, Burst] = NO_BURSTS,
) -> list[Looked]:  # fmt: skip
    """All targets, the one that is missed most of its signal first. Broken is what could be explained, is loud, or is
    gross; of a yaw rate that wheels tell only the first, as a bump in the road is loud in it.
    """
    found = []
    for name, one in left.items():
        explicable = max(one.explained, 0.0)
        share = explicable**0.5 / max(sizes[name], 1e-12)
        kind = kinds[name]
        blocks = 1 if kind.link is Link.COMMAND_TO_REPORT else BLOCKS
        loud = bursts[name].share(sizes[name], blocks) if name in bursts and not kind.by_wheels else 0.0
        visible = min(max(VISIBLE, kind.missed / max(sizes[name], 1e-12)), MOST_VISIBLE)
        far = one.total > FAR * kind.noise**2 and not kind.by_wheels
        beyond = one.total - kind.noise**2 if far else 0.0
        gross = beyond**0.5 / max(sizes[name], 1e-12)
        broken = loud > LOUD or gross > GROSS or (share > visible and explicable > LEAST_SHARE * one.total)
        noise = max(one.total - explicable, 0.0) ** 0.5
        found.append(
            Looked(
                name, kind.link, kind.unit, one.total**0.5, noise, explicable**0.5, share, broken, loud, visible, gross
            )
        )  # fmt: skip
    return sorted(found, key=lambda one: (not one.broken, -one.amount))


def card(looked: Looked, shape: Shape | None, regions: Sequence[Region], size: float) -> Card:
    """'brake (command_to_report), brake (duty) 0.15 to 0.22, 0.31 s late'."""
    clear = [one.words for one in regions if one.stands_out][:2]
    said = [] if shape is None else [shape.words(size)]
    words = ", ".join([f"{looked.signal} ({looked.link.value})", *clear, *(one for one in said if one)])
    return Card(looked, shape, tuple(regions), words)


def echo_words(echoes: Sequence[Echo]) -> list[str]:
    """What is wrong with the way of commands from the wire to the by-wire unit."""
    return [
        f"{one.strange:.1%} of the {one.channel} commands echoed were not sent at that time: frames are lost or changed"
        for one in echoes
        if one.broken
    ]


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


WINDOW_S = 0.5  # half a turn at 1 Hz, a few at what shakes faster
LOUDEST = 0.02  # of the windows: a second in a minute
FEWEST_WINDOWS = 50
MOVES = 0.05  # of the signal's deviation, within a window: what moves less stands, and its miss is rounding
FEWEST_MOVING = 10  # windows that move, for one of them to be the ordinary one
ORDINARY = 10.0  # times the ordinary window's square
NOISY = 5.0  # times that: what noise alone comes to in the loudest, which is no moment's
BLOCKS = 2  # in which there are such windows: once may be a pothole, for what a road shakes


class Burst(NamedTuple):
    """Root mean squares of the loudest windows and of the ordinary one, in the target's unit; blocks with loud ones;
    signal: root mean square of what was measured in the loudest windows, about its mean.
    """

    loud: float
    ordinary: float
    blocks: int
    signal: float = 0.0

    def share(self, size: float, blocks: int = BLOCKS) -> float:
        """Of the signal, what the loudest windows miss beyond noise; 0 where they are no louder than that may make, or
        are in fewer than so many blocks.

        size: deviation of the signal over the drives. Where it stands for most of them that says little of the moments
        in which it does not, and they are held against what it was then.
        """
        stands_out = self.blocks >= blocks and self.loud**2 > ORDINARY * self.ordinary**2
        beyond = self.loud**2 - NOISY * self.ordinary**2
        return beyond**0.5 / max(size, self.signal, 1e-12) if stands_out else 0.0


def burst_of(
    residual: Sequence[Array], measured: Sequence[Array], valid: Sequence[Array], block: Sequence[Array],
    blocks: Array, dt_s: float,
) -> Burst:  # fmt: skip
    """Of a target, all drives; rows of `blocks` only. Nothing is loud in too few windows."""
    rows = max(round(WINDOW_S / dt_s), 1)
    missed, at = _joint(residual, valid, block, rows)
    signal, _ = _joint(measured, valid, block, rows)
    seen = np.isin(at, blocks)
    missed, signal, at = missed[seen], signal[seen], at[seen]
    if len(missed) < FEWEST_WINDOWS:
        return Burst(0.0, 0.0, 0)
    squares = np.mean(missed**2, axis=1)
    moves = np.ptp(signal, axis=1) > MOVES * signal.std()
    ordinary = float(np.median(squares[moves] if moves.sum() >= FEWEST_MOVING else squares))
    loudest = np.argsort(squares)[-max(round(LOUDEST * len(squares)), 1) :]
    there = float(np.mean((signal[loudest] - signal.mean()) ** 2)) ** 0.5
    loud = float(squares[loudest].mean()) ** 0.5
    return Burst(loud, ordinary**0.5, len(np.unique(at[squares > ORDINARY * ordinary])), there)


def _joint(values: Sequence[Array], valid: Sequence[Array], block: Sequence[Array], rows: int) -> tuple[Array, Array]:
    """Windows of all drives, one behind the other, with their blocks."""
    pieces = [windows_of(*one, rows) for one in zip(values, valid, block, strict=True)]
    return np.concatenate([some for some, _ in pieces]), np.concatenate([where for _, where in pieces])


def windows_of(values: Array, valid: Array, block: Array, rows: int) -> tuple[Array, Array]:
    """(whole windows of so many rows [w, rows], the block of each [w]): all their rows count, and are of one block."""
    count = len(values) // rows
    cut = [one[: count * rows].reshape(count, rows) for one in (values, valid, block)]
    whole = cut[1].all(axis=1) & (cut[2] == cut[2][:, :1]).all(axis=1) & (cut[2][:, 0] >= 0)
    return cut[0][whole], cut[2][whole, 0]


LONGEST_S = 0.8
CLEAR_LATE_S, CLEAR_GAIN, CLEAR_BIAS = 0.01, 0.02, 0.02  # from here on it is worth a word; bias: of the signal
MOST_GAIN = 5.0  # beyond that a factor is no news of an actuator any more
MIN_SHAPE_ROWS = 256


class Shape(NamedTuple):
    """The measured signal against the simulated one. late_s: by how much it comes later; gain: factor; bias: amount
    more.
    """

    late_s: float
    gain: float
    bias: float

    def words(self, size: float) -> str:
        """As a person would say it; '' where nothing of it is clear. size: the signal's deviation."""
        said = []
        if abs(self.late_s) >= CLEAR_LATE_S:
            said.append(f"{abs(self.late_s):.2f} s {'late' if self.late_s > 0.0 else 'early'}")
        if abs(self.gain - 1.0) >= CLEAR_GAIN:
            much = f"{abs(self.gain - 1.0):.0%}" if abs(self.gain - 1.0) < MOST_GAIN else "much too"
            said.append(f"{much} {'strong' if self.gain > 1.0 else 'weak'}")
        if abs(self.bias) >= CLEAR_BIAS * size:
            said.append(f"{self.bias:+.3g} off")
        return ", ".join(said)


def shape_of(residual: Sequence[Array], measured: Sequence[Array], valid: Sequence[Array], dt_s: float) -> Shape | None:
    """Of a target, its longest drive; residual: simulated - measured. None where there is too little of it."""
    i = int(np.argmax([one.sum() for one in valid]))
    good, truth = valid[i], measured[i]
    made = truth + residual[i]
    if good.sum() < MIN_SHAPE_ROWS or np.std(made[good]) < 1e-12:
        return None
    most = round(LONGEST_S / dt_s)
    costs = [_fitted(np.roll(made, s), truth, good)[2] for s in range(-most, most + 1)]
    best = int(np.argmin(costs))
    late = best - most + _between(costs, best)
    gain, bias, _ = _fitted(np.roll(made, best - most), truth, good)
    return Shape(late * dt_s, gain, bias)


def _fitted(made: Array, truth: Array, good: Array) -> tuple[float, float, float]:
    """(gain, bias, squares) of the straight line through simulated and measured."""
    x, y = made[good], truth[good]
    dx, dy = x - x.mean(), y - y.mean()
    square = float(dx @ dx)
    gain = float(dx @ dy) / square if square > 0.0 else 1.0
    return gain, float(y.mean() - gain * x.mean()), float(dy @ dy) - gain * float(dx @ dy)


def _between(costs: Sequence[float], best: int) -> float:
    """The minimum of the parabola through three costs, in places from `best`."""
    if not 0 < best < len(costs) - 1:
        return 0.0
    a, b, c = costs[best - 1 : best + 2]
    curve = a - 2.0 * b + c
    return 0.5 * (a - c) / curve if curve > 0.0 else 0.0
