"""Fits the physical constants of plant/single_track.py by free runs (design D5).

Each window starts where the car was measured to be and runs free on the recorded actuator outputs; what counts is how
far speed, yaw rate, heading, lateral acceleration and position then are from the measured ones. Masses and geometry
stay the data sheet's: a fit sees forces per mass only. A constant that the windows do not tell much better than it was
known before keeps its data sheet's value, widened.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.data_sheet import Constant
from tunefree_hil.learn.estimate import Value, together_with
from tunefree_hil.learn.physics.unknowns import (
    AT_LEAST,
    BAND,
    EFFECTS,
    LAG,
    OFFSET,
    PLAIN,
    ROAD,
    SHAPES,
    Problem,
    Together,
    deviations_left,
    doubts_left,
    shaped,
    solved,
    together,
)
from tunefree_hil.learn.physics.windows import Off, Windows, rms_of
from tunefree_hil.learn.robust_least_squares import Least

Array = np.ndarray

LEAST_WINDOWS = 6
STEPS = 8  # that are told of a fit, however many there are
KNOWN_SHARE = 0.5  # of the doubt before the fit that may be left after it
HOPELESS = 0.95  # of it: nothing at all was learned
WORSE = 1.5  # than with all constants free, from which on what was known before is not gone back to
UNCLEAR = "the speed is missed by less with it, and these logs do not tell it from none"
TOGETHER = "these logs tell it only together with the others: the best of all together"


class PhysicsFit(NamedTuple):
    """params: [plant.params] in full. values: the fitted constants, and those of EFFECTS.

    before, after: root mean square of each target over the windows, data sheet and fit. together: of the doubts.
    """

    values: dict[str, Value]
    params: dict[str, float]
    before: dict[str, float]
    after: dict[str, float]
    windows: int
    words: tuple[str, ...]
    together: Together = Together()

    def off(self) -> Off:
        """What lies between outputs and car; only what is clear (is_clear) goes into a model."""
        found = {name: self.values[name].value if is_clear(name, self.values[name]) else 0.0 for name in EFFECTS}
        road = self.values.get(ROAD)
        share = road.value if road is not None and road.known else 0.0
        return Off(float(found[OFFSET]), float(found[BAND]), share, float(found[LAG]))


def is_clear(name: str, value: Value) -> bool:
    """Whether one of EFFECTS is there: off zero by more than the doubt about it, and by more than a trifle."""
    return value.known and (value.low > 0.0 or value.high < 0.0) and abs(value.value) > EFFECTS[name][2]


def fit(
    windows: Windows, fixed: Mapping[str, float], known: Mapping[str, Constant], brake_way: float
) -> Generator[Any, None, PhysicsFit]:
    """Fit what the windows show; yields (done, total). brake_way: duty from rest to the limit.

    Raises InputError where there are too few windows.
    """
    if not windows.pedals and len(windows.some) < LEAST_WINDOWS:
        return _unfitted(windows, fixed, known, brake_way)
    if len(windows.some) < LEAST_WINDOWS:
        raise InputError(
            f"the logs hold {len(windows.some)} windows of free motion, {LEAST_WINDOWS} are needed"
            + "".join(f"; {words}" for words in windows.words),
            code="too_short",
            key="LOG",
            hint="drive longer, on a level road and in drive gear, with reports of the actuators and of the speed",
        )
    problem = Problem(windows, fixed, known, brake_way)
    names = [name for name in problem.names if name not in SHAPES]
    x = np.zeros(len(names))
    before = rms_of(problem.misses(problem.values(names, x)))
    yield 0, STEPS
    least = solved(problem, names, x, 25)
    yield 1, STEPS
    problem.rescale(problem.values(names, least.x))
    least = solved(problem, names, least.x, 15)
    yield 2, STEPS
    names, least = shaped(problem, names, least)
    yield 3, STEPS
    found = yield from _known(problem, names, least, before, windows)
    if LAG in names and not is_clear(LAG, found.values[LAG]):
        # It stays out of the model, and fitted beside it the others would be those of another car.
        others = [one for one in names if one != LAG]
        least = solved(problem, others, np.delete(least.x, names.index(LAG)), 15)
        found = yield from _known(problem, others, least, before, windows)
        found.values[LAG] = _taken(problem, LAG, {})._replace(why=UNCLEAR)
    yield STEPS, STEPS
    return found


def _known(
    problem: Problem, names: list[str], least: Least, before: dict[str, float], windows: Windows
) -> Generator[tuple[int, int], None, PhysicsFit]:
    """What a fit of all these constants makes known, and the car that follows from that."""
    joint, jointly = problem.values(names, least.x), rms_of(problem.misses(problem.values(names, least.x)))
    first = names, least
    doubts = dict(zip(names, doubts_left(least, problem.stretches), strict=True))
    related = together(names, least, problem.stretches)
    names, least, lost = yield from _told(problem, names, least)
    values = problem.values(names, least.x if names else np.zeros(0))
    after = rms_of(problem.misses(values))
    if names and lost:  # held where they were known before, they would lend the others a certainty that nobody has
        alone = dict(zip(names, doubts_left(least, problem.stretches), strict=True))
        doubts = {name: max(doubts[name], one) for name, one in alone.items()}
    found = {name: _value(problem, names, least, name, doubts, lost) for name in problem.known}
    if any(after[name] > WORSE * jointly[name] for name in after):  # what was known before is no car that drives so
        values, after = joint, jointly
        some = {name: one for name, one in found.items() if one.why != PLAIN}
        found |= {name: together_with(one, joint[name], TOGETHER) for name, one in some.items()}
        found |= _known_jointly(problem, *first)
    return PhysicsFit(found, problem.params(values), before, after, len(windows.some), windows.words, related)


def _known_jointly(problem: Problem, names: list[str], least: Least) -> dict[str, Value]:
    """Constants that the windows tell while all the others are free: they are no less known for one that is not."""
    doubts = dict(zip(names, doubts_left(least, problem.stretches), strict=True))
    left = dict(zip(names, deviations_left(least), strict=True))
    return {name: _value(problem, names, least, name, doubts, {}) for name in names if left[name] <= KNOWN_SHARE}


def _told(
    problem: Problem, names: list[str], least: Least
) -> Generator[tuple[int, int], None, tuple[list[str], Least, dict[str, float]]]:
    """(constants that the windows tell, their fit, what is left of the doubt about each of the others): what they do
    not tell is held where it was known before, and the rest fitted again.
    """
    lost: dict[str, float] = {}
    while names:
        left = deviations_left(least)
        worst = np.flatnonzero((left > KNOWN_SHARE) & (left >= min(HOPELESS, float(left.max()))))
        if not len(worst):
            break
        lost |= {names[i]: float(left[i]) for i in worst}  # all that are hopeless at once, else the worst alone
        keep = [i for i in range(len(names)) if i not in worst]
        names = [names[i] for i in keep]
        if names:
            least = solved(problem, names, least.x[keep], 10)
        yield min(4 + len(lost), STEPS - 1), STEPS
    return names, least, lost


def _unfitted(
    windows: Windows, fixed: Mapping[str, float], known: Mapping[str, Constant], brake_way: float
) -> PhysicsFit:
    """No pedal's output is reported and there is little else: all as it was known before."""
    problem = Problem(windows._replace(some=()), fixed, known, brake_way)
    values = problem.values((), np.zeros(0))
    found = {name: _taken(problem, name, {}) for name in problem.known}
    words = f"no pedal's output is reported, and only {len(windows.some)} free runs can be made: no constant is fitted"
    return PhysicsFit(found, problem.params(values), {}, {}, 0, (words,))


def _value(
    problem: Problem, names: Sequence[str], least: Least, name: str, doubts: Mapping[str, float],
    lost: Mapping[str, float],
) -> Value:  # fmt: skip
    if name in names:
        x, half = float(least.x[names.index(name)]), float(doubts[name])
        low = max(x - half, problem.least(name))
        return Value(problem.value(name, x), problem.value(name, low), problem.value(name, x + half))
    return _taken(problem, name, lost)


def _taken(problem: Problem, name: str, lost: Mapping[str, float]) -> Value:
    constant = problem.known[name]
    low, high = constant.ends()
    low = max(low, AT_LEAST.get(name, -math.inf))
    source = "data sheet" if constant.stated else "a plausible value"
    if name in SHAPES and name in problem.names and name not in lost:  # tried, and left out again
        return Value(constant.value, low, high, False, PLAIN)
    if name in lost:
        why = f"these logs leave {min(lost[name], 1.0):.0%} of the doubt there was"
    else:
        why = "the logs lack the outputs that move it"
    return Value(constant.value, low, high, False, f"{why}; {source}")
