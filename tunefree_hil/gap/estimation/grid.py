"""Where a candidate's search begins: a coarse grid over its own parameters, with what recalibration could do at each.

What a delay does to an error is rugged, so no slope is trusted before a grid was laid. The slopes of what recalibration
moves are those of the model that the candidate is added to, so a point of the grid is one simulation: what
recalibration could still do there is a small linear problem.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.estimation.least_squares import Fitted, Free, Problem, Slopes, ends_of, walled
from tunefree_hil.gap.estimation.residuals import Residuals, apart

Array = np.ndarray

EVEN, FACTORS = 12, 8  # points of a grid: even ones, and of what goes by a logarithm
# Of a delay, from one point to the next: edges a few hundredths of a second too early or late are worse than none moved
# at all, and a coarser grid has no point from which a slope leads to the truth
DELAY_STEP_S, DELAY_SHARE = 0.015, 0.1
AMOUNTS = (0.03, 0.1, 0.3, 1.0)  # of the prior's ends, to either side: of what is nearly linear, and may be small
SMALL = AMOUNTS[:2]  # those of a factor, beside its even grid, which has no point near neutral
# What recalibration has of the very same kind, and its sign: beside the effect it would move the other way, and what is
# left of both is a signal smoothed by nothing that a car has, or a delay that is told from it by nothing but rounding.
TWINS = {"ins_latency.delay_s": ("clock.ins_s", 1.0), "report_latency.delay_s": ("clock.ins_s", -1.0)}
NO_TWIN = ("", 1.0)
HALVINGS = 7  # of the way between two points of a grid, to where a limit begins to act
TOUCHES = (0.0, 0.03, 0.07, 0.12, 0.2, 0.33, 0.5)  # of the way from there to the point that cuts off too much
CLOSER = 0.5  # of a target's mean square: who takes off more is on to something, whatever its noise says
FINER = 9  # points between the best one's neighbours: a delay is rugged on the scale of a tick


class Start(NamedTuple):
    """The best point of a grid: keys that move and z of them (all but `free`: recalibration done there), and what it
    gains over the model that the candidate is added to, in squares. plain: of several parameters the best point with
    all but the first neutral, where that is another one. moves: what the grid's points move of any target at the most,
    root mean square where it may be looked at, as a share of its signal. closer: the point that takes most off any
    target's mean square, where that is much and another one: a filter that fits what a limit leaves makes the corners
    that are left beside it louder than all of that was.
    """

    keys: tuple[str, ...]
    z: Array
    gain: float
    plain: Start | None = None
    moves: float = 0.0
    closer: Start | None = None

    @property
    def worth(self) -> float:
        """What it gains, or more than any: it is to be fitted in any case."""
        return self.gain if self.closer is None else math.inf


class _Felt(NamedTuple):
    """A target of the model that candidates are added to, whitened, in judged blocks only: slopes [m, p], and what its
    own residual gives.
    """

    slopes: Array
    slope: Array
    square: float


class Scan:
    """Grids of candidates beside one model. slopes: of that model's keys, where it stands; noise: the model whose noise
    is taken for everybody's (None: that one's own).
    """

    def __init__(self, problem: Problem, start: Fitted, slopes: Slopes, noise: Fitted | None = None) -> None:
        self.problem, self.start, self._slopes = problem, start, slopes
        self.colours = {name: one.colour for name, one in (start if noise is None else noise).sums.items()}
        self._curve = np.zeros((len(start.keys), len(start.keys)))
        self._felt = {name: self._feel(name, residual) for name, residual in start.residuals.items()}
        self._sizes = {name: problem.work.size(name) for name in start.residuals}

    def best(self, free: Sequence[Free]) -> Start:
        """Over the whole grid, and where recalibration has put the very same parameter: taking its place must be no
        loss. Raises InputError where no value of it makes a car.
        """
        found = self._apart(free, self._best(free, [*grid_of(free), *self._recalibrated(free)]))
        if len(free) == 1 and not math.isfinite(free[0].neutral) and not self._acts(free[0], float(found.z[-1])):
            wide, found = found, self._best(free, [found.z[-1:], *self._touched(free[0])])
            found = found._replace(moves=max(wide.moves, found.moves), closer=wide.closer or found.closer)
        neutral = [one.place(one.neutral) for one in free[1:]]
        if np.array_equal(found.z[len(found.z) - len(neutral) :], neutral):
            return found
        # A grid of two is coarse: its best point may trade the one for the other on a ridge that leads nowhere
        try:
            return found._replace(plain=self._best(free, [np.array([u, *neutral]) for u in _places(free[0])]))
        except InputError:
            return found

    def _apart(self, free: Sequence[Free], found: Start) -> Start:
        """With the closer point only where it is another one."""
        own = -len(free)
        same = found.closer is not None and np.array_equal(found.closer.z[own:], found.z[own:])
        return found._replace(closer=None) if same else found

    def finer(self, free: Sequence[Free], found: Start) -> Start:
        """Around a point that was found, where there is one parameter and what it does is not nearly linear."""
        points = self._around(free, found)
        return max(found, self._best(free, points), key=lambda one: one.gain) if points else found

    def nearer(self, free: Sequence[Free], found: Start) -> Start:
        """The same of a `closer` point: the one around it that takes off most."""
        return self._best(free, self._around(free, found) or [found.z[-len(free) :]]).closer or found

    def _around(self, free: Sequence[Free], found: Start) -> list[Array]:
        if len(free) != 1 or free[0].low < 0.0:
            return []
        places = sorted(_places(free[0]))
        i = int(np.argmin(np.abs(np.array(places) - found.z[-1])))
        wide = max(places[min(i + 1, len(places) - 1)] - places[i], places[i] - places[max(i - 1, 0)])
        near = found.z[-1] + wide * np.linspace(-1.0, 1.0, FINER)
        return [np.array([u]) for u in np.clip(near, free[0].least, free[0].most)]

    def kept(self, free: Sequence[Free]) -> list[int]:
        """The model's keys that are fitted beside a candidate: not what is the candidate's own."""
        loose = {one.key for one in free} | {TWINS.get(one.key, NO_TWIN)[0] for one in free}
        return [i for i, key in enumerate(self.start.keys) if key not in loose]

    def slopes(self, free: Sequence[Free]) -> Slopes:
        """Of those."""
        return without(self._slopes, self.kept(free))

    def _touched(self, one: Free) -> list[Array]:
        """Points at which a limit is hardly touched. Of a coarse grid one point may cut off far too much, and the next
        nothing at all, while the limit lies between: just below what the drives reach.
        """
        places = sorted(_places(one))
        acting = [u for u in places if self._acts(one, u)]
        beyond = [u for u in places if u not in acting]
        if not acting or not beyond or max(acting) > max(beyond):
            return []
        begin = acts = max(acting)
        idle = min(u for u in beyond if u > acts)
        for _ in range(HALVINGS):
            middle = 0.5 * (acts + idle)
            acts, idle = (middle, idle) if self._acts(one, middle) else (acts, middle)
        return [np.array([acts - share * (acts - begin)]) for share in TOUCHES]

    def _acts(self, one: Free, u: float) -> bool:
        """Whether a value changes anything of what is compared, in judged blocks."""
        start = self.start
        keys, z = (*start.keys, one.key), np.append(start.z, u)
        try:
            residuals = self.problem.work.residuals(self.problem.values(keys, z, (*start.free, one)))
        except InputError:
            return True  # a limit so low makes no such effect
        for name, some in residuals.items():
            was = start.residuals[name]
            if not unchanged(some, was) and self._white(name, [a - b for a, b in zip(some, was, strict=True)]).any():
                return True
        return False

    def _recalibrated(self, free: Sequence[Free]) -> list[Array]:
        """The point at which the model has these parameters by recalibration; none where it has not."""
        values, found = self.start.values, list[float]()
        for one in free:
            twin, sign = TWINS.get(one.key, NO_TWIN)
            if one.key not in values and twin not in values:
                return []
            found.append(values[one.key] if one.key in values else sign * values[twin])
        places = [one.place(value) for one, value in zip(free, found, strict=True)]
        return [np.clip(places, [one.least for one in free], [one.most for one in free])]

    def _best(self, free: Sequence[Free], points: Sequence[Array]) -> Start:
        """The best of some points. What it cost recalibration to move the same is gained: an effect has no prior."""
        kept, start = self.kept(free), self.start
        keys = tuple(start.keys[i] for i in kept) + tuple(one.key for one in free)
        loose, base = (*start.free, *free), np.array([start.z[i] for i in kept])
        prior = self.problem.prior([start.keys[i] for i in kept], start.free)
        gone = float(start.z @ start.prior @ start.z - base @ prior @ base)
        before = self._left(start.residuals, kept, base, prior)[0] + gone
        best, closest = None, None
        moves, most = 0.0, CLOSER
        for u in points:
            z = np.concatenate([base, u])
            try:
                residuals = self.problem.work.residuals(self.problem.values(keys, z, loose))
            except InputError:  # a value that makes no such effect
                continue
            moves = max(moves, self._moved(residuals))
            left, step = self._left(residuals, kept, base, prior)
            low, high = ends_of(keys, loose)
            if best is None or before - left > best.gain:
                best = Start(keys, np.clip(np.concatenate([base + step, u]), low, high), before - left)
            if (share := self._taken_off(residuals)) > most:
                most, closest = share, Start(keys, np.clip(z, low, high), before - left)
        if best is None:
            raise InputError("no value of it makes a car", code="no_such_effect", key=",".join(one.key for one in free))
        return best._replace(moves=moves, closer=closest)

    def _taken_off(self, residuals: Residuals) -> float:
        """Of the target of which most of the start's mean square is taken off, the share, where it may be looked at."""
        work, shares = self.problem.work, list[float]()
        for name, some in residuals.items():
            was = self.start.residuals[name]
            if not unchanged(some, was):
                now, before = (_square(one, work.seen(name)) for one in (some, was))
                shares.append(1.0 - now / max(before, 1e-300))
        return max(shares, default=0.0)

    def _moved(self, residuals: Residuals) -> float:
        """What residuals differ by from the start's, of the target that differs most, as a share of its signal."""
        work = self.problem.work
        shares = [
            apart(some, self.start.residuals[name], work.seen(name)) / max(self._sizes[name], 1e-12)
            for name, some in residuals.items()
            if not unchanged(some, self.start.residuals[name])
        ]
        return max(shares, default=0.0)

    def _left(self, residuals: Residuals, kept: Sequence[int], z: Array, prior: Array) -> tuple[float, Array]:
        """(cost, step) of the best that recalibration can do from z with these residuals, by the normal equations.
        prior [p, p]: precision, of what is kept.
        """
        slope, square = np.zeros(len(self.start.keys)), 0.0
        for name, some in residuals.items():
            felt = self._felt[name]
            if not unchanged(some, self.start.residuals[name]):
                white = self._white(name, some)
                felt = _Felt(felt.slopes, white @ felt.slopes, float(white @ white))
            slope, square = slope + felt.slope, square + felt.square
        low, high = ends_of(self.start.keys, self.start.free)
        curve, slope = self._curve[np.ix_(kept, kept)] + prior, slope[kept] + prior @ z
        walls = self.problem.walls([self.start.keys[i] for i in kept], self.start.free)
        step = walled(curve, slope, z, low[kept], high[kept], walls)
        return square + float(z @ prior @ z) + float(2.0 * slope @ step + step @ curve @ step), step

    def _feel(self, name: str, residual: list[Array]) -> _Felt:
        columns, pieces = self._slopes.by_target[name]
        joint = self._white(name, [np.column_stack([r, p]) for r, p in zip(residual, pieces, strict=True)])
        slopes = np.zeros((len(joint), len(self.start.keys)))
        slopes[:, columns] = joint[:, 1:]
        self._curve[np.ix_(columns, columns)] += joint[:, 1:].T @ joint[:, 1:]
        return _Felt(slopes, joint[:, 0] @ slopes, float(joint[:, 0] @ joint[:, 0]))

    def _white(self, name: str, residual: Sequence[Array]) -> Array:
        """Whitened, in units of the noise, its rows in judged blocks."""
        colour = self.colours[name]
        rows, at = self.problem.work.white(name, residual, colour)
        return rows[np.isin(at, self.problem.judged())] / np.sqrt(colour.stretch)


def _square(residual: Sequence[Array], rows: Sequence[Array]) -> float:
    return sum(float(np.sum(one[seen] ** 2)) for one, seen in zip(residual, rows, strict=True))


def unchanged(some: Sequence[Array], others: Sequence[Array]) -> bool:
    """Whether residuals of a target are the same, drive by drive."""
    return all(np.array_equal(a, b) for a, b in zip(some, others, strict=True))


def without(slopes: Slopes, kept: Sequence[int]) -> Slopes:
    """The slopes of some columns, numbered anew."""
    place = {old: new for new, old in enumerate(kept)}
    found = {}
    for name, (columns, pieces) in slopes.by_target.items():
        felt = [c for c, column in enumerate(columns) if int(column) in place]
        numbers = np.array([place[int(columns[c])] for c in felt], dtype=np.int64)
        found[name] = (numbers, [piece[:, felt] for piece in pieces])
    return Slopes(found)


def grid_of(free: Sequence[Free]) -> list[Array]:
    """Points over the priors of one parameter; of two, a coarser grid of both."""
    first = _places(free[0])
    if len(free) == 1:
        return [np.array([u]) for u in first]
    places = product(*((0.1, one.place(one.neutral), 0.9) for one in free[1:]))
    return [np.array([u, *more]) for u, more in product(first, places)]


def _places(one: Free) -> list[float]:
    """Of what may go to either side of neutral, amounts to both, a factor's by its logarithm; else even places."""
    even = [float(u) for u in np.linspace(0.0, 1.0, FACTORS if one.logarithmic else EVEN)]
    if one.key.endswith("delay_s") and not one.logarithmic:
        return _delays(one)
    if not one.low < one.neutral < one.high:
        return even
    middle = one.place(one.neutral)
    shares = SMALL if one.logarithmic else AMOUNTS
    amounts = [middle + share * (end - middle) for end in (0.0, 1.0) for share in shares]
    return even + amounts if one.logarithmic else amounts


def _delays(one: Free) -> list[float]:
    found = [one.low]
    while found[-1] < one.high:
        found.append(min(found[-1] + max(DELAY_STEP_S, DELAY_SHARE * found[-1]), one.high))
    return [one.place(delay_s) for delay_s in found]
