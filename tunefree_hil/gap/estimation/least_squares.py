"""A question as a problem of least squares: keys that may move, their slopes, normal equations by target and block.

Nuisances (null.py) are counted in standard deviations of their priors, free parameters in u: from 0 to 1 over theirs.
Residuals are whitened and in units of the noise, so that squares are log likelihoods.

Steps of a least-squares problem within bounds: the least of a convex quadratic, by active sets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.estimation.noise import Colour
from tunefree_hil.gap.estimation.nuisance import Nuisance
from tunefree_hil.gap.estimation.residuals import Residuals, Work
from tunefree_hil.gap.measured.blocks import PROOF

Array = np.ndarray

SLOPE = 0.02  # of a unit of a free parameter, for slopes
SIGMA_SLOPE = 0.5  # of a standard deviation, of a nuisance
TOUCHED = 1e-9  # of a target's size: what changes less is not touched by a parameter
MOST_SIGMA = 2.0  # of a prior (gap/estimation/nuisance.py): what recalibration may do at most
TIGHT = 0.9  # variance of a direction, of numbers that are each 1: what is not known better than that has no such end


class Free(NamedTuple):
    """A parameter that is looked for. u is its own number on its scale, from 0 (low) to 1 (high) within the prior.

    least, most: ends of u that it may reach, beyond the prior where that makes sense. neutral: its neutral value.
    doubt: standard deviation, in its unit at neutral, with which the model's own calibration knows that number; share:
    of the parameter itself, where it counts by a constant of the model that its calibration does not know; drift: by
    how much that number is another one from day to day, in its unit at neutral.
    """

    key: str
    low: float
    high: float
    logarithmic: bool
    neutral: float
    least: float
    most: float
    doubt: float = 0.0
    share: float = 0.0
    drift: float = 0.0

    def value(self, u: float) -> float:
        """The parameter at u."""
        if self.logarithmic:
            return self.low * (self.high / self.low) ** u
        return self.low + u * (self.high - self.low)

    def place(self, value: float) -> float:
        """u of a value."""
        if self.logarithmic:
            return math.log(max(value, 1e-300) / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


class Sums(NamedTuple):
    """A target's normal equations by block: columns [c] that it feels; square [b], slope [b, c], curve [b, c, c];
    count [b] of rows. Residuals are whitened, in units of the noise.
    """

    columns: Array
    square: Array
    slope: Array
    curve: Array
    count: Array
    colour: Colour


class Fitted(NamedTuple):
    """A model that was fitted: name; keys [p] of what it moved, z [p]: where to (nuisances in standard deviations, free
    parameters in u); free: how many of the keys, at the end, are free ones; values: as the graph takes them.

    prior [p, p]: precision of the priors of what is not free. sums: by target, at the solution; residuals: there.
    """

    name: str
    keys: tuple[str, ...]
    z: Array
    free: tuple[Free, ...]
    values: dict[str, float]
    prior: Array
    sums: dict[str, Sums]
    residuals: Residuals


class Slopes(NamedTuple):
    """What a unit of each key does to each target: by target (columns [c], slopes a drive [m, c])."""

    by_target: dict[str, tuple[Array, list[Array]]]


class Problem:
    """Fits of one question. nuisances: by key, in their order. correlation [n, n]: of their priors; None: of none.
    known: whether the model's own logs have told it: then what numbers come to together has ends (steps.MOST_TOGETHER).
    """

    def __init__(
        self, work: Work, nuisances: Sequence[Nuisance], correlation: Array | None = None, *, known: bool = False
    ) -> None:
        self.work, self._known = work, known
        self._walls: dict[tuple[str, ...], Array] = {}
        self.nuisances = {one.key: one for one in nuisances}
        self._correlation = np.eye(len(nuisances)) if correlation is None else correlation

    def prior(self, keys: Sequence[str], free: Sequence[Free]) -> Array:
        """Precision [p, p] of the priors of some keys, each in its unit; 0 for what is free within its ends."""
        loose = is_free(keys, free)
        place = {key: i for i, key in enumerate(self.nuisances)}
        some = [place[key] for key, one in zip(keys, loose, strict=True) if not one]
        found = np.zeros((len(keys), len(keys)))
        found[np.ix_(~loose, ~loose)] = np.linalg.inv(self._correlation[np.ix_(some, some)])
        return found

    def walls(self, keys: Sequence[str], free: Sequence[Free]) -> Array:
        """Directions [w, p] of some keys' z that are known better than each number alone: z is within MOST_TOGETHER of
        nought along each.
        """
        loose = is_free(keys, free)
        some = tuple(key for key, one in zip(keys, loose, strict=True) if not one)
        if some not in self._walls:
            place = {key: i for i, key in enumerate(self.nuisances)}
            at = [place[key] for key in some]
            variance, along = np.linalg.eigh(self._correlation[np.ix_(at, at)])
            tight = variance < (TIGHT if self._known else 0.0)
            self._walls[some] = (along[:, tight] / np.sqrt(variance[tight])).T
        found = np.zeros((len(self._walls[some]), len(keys)))
        found[:, ~loose] = self._walls[some]
        return found

    def values(self, keys: Sequence[str], z: Array, free: Sequence[Free]) -> dict[str, float]:
        """As the graph takes them."""
        by_key = {one.key: one for one in free}
        found = {}
        for key, at in zip(keys, z, strict=True):
            if key in by_key:
                found[key] = by_key[key].value(float(at))
            else:
                nuisance = self.nuisances[key]
                found[key] = nuisance.neutral + nuisance.sigma * float(at)
        return found

    def slopes(
        self, keys: Sequence[str], z: Array, free: Sequence[Free], which: Sequence[int], at: Residuals
    ) -> Slopes:
        """By differences; one simulation each. at: the residuals at z."""
        free_keys = {one.key: one for one in free}
        moved: list[Residuals] = []
        steps = []
        for i in which:
            step = SIGMA_SLOPE
            if keys[i] in free_keys:
                one = free_keys[keys[i]]
                step = SLOPE if z[i] + SLOPE <= one.most else -SLOPE
            there = z.copy()
            there[i] += step
            moved.append(self.work.residuals(self.values(keys, there, free)))
            steps.append(step)
        found = {}
        for name, here in at.items():
            columns = [
                [(one[name][d] - here[d]) / step for d in range(len(here))]
                for one, step in zip(moved, steps, strict=True)
            ]
            size = max(max(float(np.abs(piece).max()) for piece in here), 1e-12)
            felt = [
                c for c, column in enumerate(columns) if max(float(np.abs(p).max()) for p in column) > TOUCHED * size
            ]
            pieces = [
                np.stack([columns[c][d] for c in felt], axis=1) if felt else np.zeros((len(here[d]), 0))
                for d in range(len(here))
            ]
            found[name] = (np.array([which[c] for c in felt], dtype=np.int64), pieces)
        return Slopes(found)

    def sums(self, residuals: Residuals, slopes: Slopes, colours: dict[str, Colour]) -> dict[str, Sums]:
        """Normal equations of all targets."""
        return {name: self.sums_of(name, residuals[name], slopes.by_target[name], colours[name]) for name in residuals}

    def sums_of(self, name: str, residual: list[Array], slope: tuple[Array, list[Array]], colour: Colour) -> Sums:
        """Normal equations of a target."""
        columns, pieces = slope
        joint = [np.column_stack([r, s]) for r, s in zip(residual, pieces, strict=True)]
        rows, blocks = self.work.white(name, joint, colour)
        count, width = self.work.blocks.count, rows.shape[1]
        whole = np.zeros((count, width, width))
        for b in np.unique(blocks):
            some = rows[blocks == b]
            whole[b] = some.T @ some
        size = np.bincount(blocks, minlength=count).astype(float)
        return Sums(columns, whole[:, 0, 0], whole[:, 0, 1:], whole[:, 1:, 1:], size, colour)

    def colours(self, residuals: Residuals) -> dict[str, Colour]:
        """The noise that these residuals would be."""
        return {name: self.work.colour(name, some) for name, some in residuals.items()}

    def judged(self) -> Array:
        """Blocks that are fitted on or chosen by: all but those that prove."""
        return np.flatnonzero(self.work.blocks.roles != PROOF)


def is_free(keys: Sequence[str], free: Sequence[Free]) -> Array:
    """Which keys [p] are free within their ends; all others are nuisances."""
    loose = {one.key for one in free}
    return np.array([key in loose for key in keys], dtype=bool)


def gathered(sums: dict[str, Sums], width: int, blocks: Array) -> tuple[Array, Array, float]:
    """(curve, slope, square) over targets and blocks, each target's noise stretched."""
    curve, slope, square = np.zeros((width, width)), np.zeros(width), 0.0
    for one in sums.values():
        scale = 1.0 / one.colour.stretch
        at = one.columns
        curve[np.ix_(at, at)] += scale * one.curve[blocks].sum(axis=0)
        slope[at] += scale * one.slope[blocks].sum(axis=0)
        square += scale * float(one.square[blocks].sum())
    return curve, slope, square


def cost_of(sums: dict[str, Sums], z: Array, prior: Array, blocks: Array) -> float:
    """Squares over the noise, and those of the prior [p, p]."""
    square = sum(float(one.square[blocks].sum()) / one.colour.stretch for one in sums.values())
    return square + float(z @ prior @ z)


def squares(
    problem: Problem, residuals: Residuals, colours: dict[str, Colour], before: Residuals, sums: dict[str, Sums],
    blocks: Array,
) -> float:  # fmt: skip
    """Squares over the noise in some blocks; of targets that have not changed they are those of `sums`."""
    total = 0.0
    for name, some in residuals.items():
        colour = colours[name]
        if all(np.array_equal(a, b) for a, b in zip(some, before[name], strict=True)):
            total += float(sums[name].square[blocks].sum()) / colour.stretch
            continue
        rows, at = problem.work.white(name, some, colour)
        total += float(np.sum(rows[np.isin(at, blocks)] ** 2)) / colour.stretch
    return total


def ends_of(keys: Sequence[str], free: Sequence[Free]) -> tuple[Array, Array]:
    """How far each key may go."""
    by_key = {one.key: one for one in free}
    low = np.array([by_key[key].least if key in by_key else -MOST_SIGMA for key in keys])
    high = np.array([by_key[key].most if key in by_key else MOST_SIGMA for key in keys])
    return low, high


# Standard deviations that what numbers come to together may go where the model's own logs have told it
# (gap/estimation/calibration_priors.py). Freely, five clean logs of development's cars went 1.6 to 3.3, a throttle that gave a tenth less
# 4.8: there recalibration took the place of its name.
MOST_TOGETHER = 3.0
STIFF = 1e4  # times what the data know of a direction: how hard its end is
SLACK = 1.05  # of MOST_TOGETHER: so far a wall that is no harder than that gives way
HELD_TURNS = 6
RELEASES = 4  # turns of a bounded step, for each of its parameters
RELEASED = 1e-9  # of the greatest slope: a pull that is less lets nothing go
FLAT = 1e-6  # added to every curvature: what the data do not feel stays where it is


def walled(curve: Array, slope: Array, z: Array, low: Array, high: Array, walls: Array) -> Array:
    """The same as `bounded`, within MOST_TOGETHER of nought along each of `walls` [w, p] besides: what goes farthest
    beyond one is held there, one after the other, and let go, one after the other, where that pulls it back inside.
    Where they take turns for ever, what was found last is drawn back inside (`drawn_in`).
    """
    stiff = STIFF * (1.0 + np.einsum("wi,ij,wj->w", walls, curve, walls) / np.sum(walls**2, axis=1) ** 2)
    held = np.zeros(len(walls))
    for _ in range(RELEASES * len(walls) + 1):
        by = stiff * np.abs(held)
        more = slope + walls.T @ (by * (walls @ z - MOST_TOGETHER * held))
        step = bounded(curve + (walls.T * by) @ walls, more, z, low, high)
        there = walls @ (z + step)
        inward = np.where(held != 0.0, MOST_TOGETHER - there * held, 0.0)
        beyond = np.where(held == 0.0, np.abs(there) - MOST_TOGETHER, 0.0)
        if inward.max(initial=0.0) > 0.0:
            held[int(np.argmax(inward))] = 0.0
        elif beyond.max(initial=0.0) > 0.0:
            worst = int(np.argmax(beyond))
            held[worst] = np.sign(there[worst])
        else:
            break
    return drawn_in(z + step, walls) - z


def drawn_in(z: Array, walls: Array) -> Array:
    """z, or where it is plainly beyond a wall, what walls know of it drawn back towards nought until it is beyond none:
    there all that is within bounds stays within them.
    """
    far = float(np.abs(walls @ z).max(initial=0.0)) / MOST_TOGETHER
    return np.where((walls != 0.0).any(axis=0), z / far, z) if far > SLACK else z


def bounded(curve: Array, slope: Array, z: Array, low: Array, high: Array) -> Array:
    """The step from z to the least of a convex quadratic within bounds, by an active set: what would go beyond an end
    is held there, and let go again where the rest, once it has moved, pulls it back.
    """
    curve, lowest, highest = curve + FLAT * np.eye(len(z)), low - z, high - z
    step, held = _held_in_turn(curve, slope, lowest, highest)
    least = RELEASED * (1.0 + float(np.abs(slope).max(initial=0.0)))
    for _ in range(RELEASES * len(z)):
        loose = ~held
        pull = -(slope + curve @ step)
        move = np.zeros(len(z))
        move[loose] = np.linalg.solve(curve[np.ix_(loose, loose)], pull[loose])
        end, moving = np.where(move > 0.0, highest, lowest), move != 0.0
        room = np.full(len(z), np.inf)
        room[moving] = (end - step)[moving] / move[moving]
        share = min(float(room.min(initial=np.inf)), 1.0)
        step = np.where(room <= share, end, np.clip(step + share * move, lowest, highest))
        if share < 1.0:
            held |= room <= share
            continue
        pull = -(slope + curve @ step)
        inward = np.where(step <= lowest, pull, 0.0) + np.where(step >= highest, -pull, 0.0)
        inward[~held | (lowest >= highest)] = 0.0
        if inward.max(initial=0.0) <= least:
            break
        held[int(np.argmax(inward))] = False
    return step


def _held_in_turn(curve: Array, slope: Array, lowest: Array, highest: Array) -> tuple[Array, Array]:
    """(a step within bounds, what is held at one): what goes beyond is held there, in turn, and stays. Near the least,
    but of parameters that do nearly the same all may be held that go beyond together, where one would do.
    """
    step, loose = np.zeros(len(slope)), np.ones(len(slope), dtype=bool)
    for _ in range(HELD_TURNS):
        pull = slope[loose] + curve[np.ix_(loose, ~loose)] @ step[~loose]
        step[loose] = -np.linalg.solve(curve[np.ix_(loose, loose)], pull)
        within = np.clip(step, lowest, highest)
        beyond = loose & (within != step)
        step = within
        if not beyond.any():
            break
        loose &= ~beyond
        if not loose.any():
            break
    return step, ~loose
