"""What samplers learn from and suggest: scored points, their values and seeds, and the unit box of a space."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tunefree_hil.tune.space import Axis, Space

SMALLEST_SCORE = 1e-6  # a score of 0 (no error at all) has no logarithm


class ScoredPoint(NamedTuple):
    """Parameters and score of a finished trial, which a sampler learns from.

    violation: Of the requirements, 0 where they are met; None in a study without requirements.
    objectives: Of a study of several objectives, lower is better each; empty where the score is the only one.
    """

    parameters: dict[str, float]
    score: float
    violation: float | None = None
    objectives: tuple[float, ...] = ()


def sampler_value_from_score(score: float) -> float:
    """The logarithm of a score, which the sampler gets as value. TPE uses ranks only, so it is not affected."""
    return math.log(max(score, SMALLEST_SCORE))


def derive_slot_seed(seed: int, slot: int) -> int:
    """A 32-bit seed for the sampler of one slot, independent of other slots and of neighbouring study seeds."""
    return int(np.random.SeedSequence([seed, slot]).generate_state(1)[0])


def to_unit(space: Space, parameters: Mapping[str, float]) -> np.ndarray:
    """The place of each parameter in its range, 0 to 1 on its scale, shape (axes,)."""
    return np.array([share_from_value(axis, parameters[axis.name]) for axis in space.axes])


def from_unit(space: Space, unit: np.ndarray) -> dict[str, float]:
    """The inverse of `to_unit`; values are clipped into the space and rounded to binary32."""
    return {axis.name: value_from_share(axis, float(share)) for axis, share in zip(space.axes, unit, strict=True)}


def share_from_value(axis: Axis, value: float) -> float:
    """The place of a value in the range of its axis, 0 to 1; a value of a grid is in the middle of its cell."""
    if axis.grid:
        return (axis.grid.index(axis.clip(value)) + 0.5) / len(axis.grid)
    if axis.high <= axis.low:
        return 0.5
    if axis.log:
        return math.log(value / axis.low) / math.log(axis.high / axis.low)
    return (value - axis.low) / (axis.high - axis.low)


def value_from_share(axis: Axis, share: float) -> float:
    """The allowed value at a place of the range of an axis."""
    if axis.grid:
        return axis.grid[min(int(share * len(axis.grid)), len(axis.grid) - 1)]
    if axis.log:
        return axis.clip(axis.low * (axis.high / axis.low) ** share)
    return axis.clip(axis.low + share * (axis.high - axis.low))
