"""What recalibration would move further than it may: a number at its end that the logs still pull at."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.evidence import LEAST_NATS
from tunefree_hil.gap.problem import Fitted, gathered

Array = np.ndarray

AT_END = 1.8  # standard deviations, of the 2 that it may go


class Held(NamedTuple):
    """A number of recalibration's: key; z: where it is held, in standard deviations; nats: what letting it go further
    would gain, all that is not held moving with it.
    """

    key: str
    z: float
    nats: float

    @property
    def words(self) -> str:
        """For who reads."""
        return f"recalibration moves {self.key} by {self.z:+.1f} standard deviations"


def held_back(model: Fitted, blocks: Array) -> list[Held]:
    """Of a fitted model what is held back by more than LEAST_NATS, the most first. blocks: those that it was fitted on.

    By the curvature of the fit, and not simulated: far beyond its end a number may do something else.
    """
    curve, slope, _ = gathered(model.sums, len(model.keys), blocks)
    curve, slope = curve + model.prior, slope + model.prior @ model.z
    loose = np.ones(len(model.keys), dtype=bool)
    loose[: len(model.keys) - len(model.free)] = np.abs(model.z[: len(model.keys) - len(model.free)]) <= AT_END
    found = []
    for i in np.flatnonzero(~loose):
        some = np.append(np.flatnonzero(loose), i)
        inner = np.linalg.pinv(curve[np.ix_(some, some)])[-1, -1]
        nats = 0.5 * float(slope[i] ** 2 * inner)
        if slope[i] * model.z[i] < 0.0 and nats > LEAST_NATS:
            found.append(Held(model.keys[i], float(model.z[i]), nats))
    return sorted(found, key=lambda one: -one.nats)
