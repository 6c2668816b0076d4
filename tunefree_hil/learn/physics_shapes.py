"""Which constants of a car's shape a fit takes in: those that its free runs need. How late it pushes is one of them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tunefree_hil.learn.least import Least
from tunefree_hil.learn.physics_doubts import stretches_of
from tunefree_hil.learn.physics_problem import LAG, Problem, solved
from tunefree_hil.learn.windows import TARGETS

Array = np.ndarray

# Fitted where the speed's squares are then less by a share of PAYS, and by more than chance (one standard error) has it
# from stretch to stretch. Where they explain nothing they would only take from the others what the logs know of them.
SHAPES, PAYS = ("drive_corner", "overrun_force_n", "brake_rise_per_frac", LAG), 0.1
PLAIN = "with it the squares of the missed speed are less by under a tenth, or by no more than chance"


def shaped(problem: Problem, plain: list[str], least: Least) -> tuple[list[str], Least]:
    """With those of SHAPES that pay. All at once first: where no power was found, there is no corner to find."""
    tried = [one for one in SHAPES if one in problem.names]
    if not tried:
        return plain, least
    names = [*plain, *tried]
    found = solved(problem, names, np.zeros(len(names)), 25)
    if not pays(_speed_squares(problem, plain, least.x), _speed_squares(problem, names, found.x)):
        return plain, least
    for shape in tried:
        fewer = [one for one in names if one != shape]
        without = solved(problem, fewer, np.delete(found.x, names.index(shape)), 15)
        if not pays(_speed_squares(problem, fewer, without.x), _speed_squares(problem, names, found.x)):
            names, found = fewer, without
    problem.rescale(problem.values(names, found.x))
    return names, solved(problem, names, found.x, 15)


def pays(before: Array, after: Array) -> bool:
    """Whether squares by stretch [s] are less by PAYS, and by more than one standard error. Of one stretch nobody knows
    what chance does.
    """
    gain = before - after
    if len(gain) < 2:
        return False
    chance = float(np.std(gain, ddof=1)) / math.sqrt(len(gain))
    return float(gain.mean()) > max(PAYS * float(before.mean()), chance)


def _speed_squares(problem: Problem, names: Sequence[str], x: Array) -> Array:
    """Mean square by which the speed is missed, by stretch that saw it."""
    misses = problem.misses(problem.values(names, x))[:, :, TARGETS.index("speed_mps")]
    at = stretches_of(problem.some)
    by_stretch = (misses[at == one] ** 2 for one in np.unique(at))
    return np.array([np.nanmean(one) for one in by_stretch if np.isfinite(one).any()])
