"""Points of a scrambled Sobol sequence, which cover the box more evenly than random ones.

Slot n gets point n of the sequence of the study seed, so trials in flight need no care.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats.qmc import Sobol

from tunefree_hil.tune.sampling.points import from_unit
from tunefree_hil.tune.space import Space


def suggest_sobol_points(space: Space, *, seed: int, slots: Sequence[int]) -> list[dict[str, float]]:
    """The points of these slots, which depend on the seed of the study alone."""
    return [from_unit(space, draw_sobol_units(len(space.axes), 1, seed, skip=slot)[0]) for slot in slots]


def draw_sobol_units(dimensions: int, count: int, seed: int, *, skip: int = 0) -> np.ndarray:
    """Consecutive points of a scrambled Sobol sequence after `skip` of them, shape (count, dimensions)."""
    sequence = Sobol(dimensions, scramble=True, rng=np.random.default_rng(seed))
    if skip:  # SciPy overflows at 0
        sequence.fast_forward(skip)
    return sequence.random(count)
