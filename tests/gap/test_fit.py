"""A fit goes on until nothing is gained: on one key whose slope goes flat on the way, so that no step gets there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tunefree_hil.gap.fit import ENOUGH, fit_null, fit_on
from tunefree_hil.gap.noise import Colour
from tunefree_hil.gap.null import Nuisance
from tunefree_hil.gap.problem import Problem, cost_of

KEY, TRUTH, FLOOR = "drive.gain", 1.5, 1e-3
NOISE = FLOOR * np.random.default_rng(3).standard_normal(400)


class Flat:
    """One target, whose error is the cube of how far the key is off: each step by slopes goes a third of the way."""

    blocks = SimpleNamespace(count=2, roles=np.array(["fit", "choose"]))

    def residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        return {"a": [(values[KEY] - TRUTH) ** 3 + NOISE]}

    def white(self, name: str, joint: list[np.ndarray], colour: Colour) -> tuple[np.ndarray, np.ndarray]:
        rows = np.concatenate(joint) / colour.sigma
        return rows, np.arange(len(rows)) % 2

    def colour(self, name: str, residual: list[np.ndarray]) -> Colour:
        return Colour(np.array([1.0]), float(np.sqrt(np.mean(residual[0] ** 2))), 1.0)


def problem() -> Problem:
    return Problem(cast(Any, Flat()), [Nuisance(KEY, 0.0, 1.0)])


def test_recalibration_alone_is_at_its_best_under_the_noise_that_it_leaves() -> None:
    """What is loud on the way to it hides the rest of the way."""
    asked = problem()
    null, _ = fit_null(asked)
    left = float(np.sqrt(np.mean(np.concatenate(null.residuals["a"]) ** 2)))
    assert left == pytest.approx(FLOOR, rel=0.05)
    again = fit_on(asked, null)
    blocks = asked.judged()
    before, after = (cost_of(null.sums, one.z, null.prior, blocks) for one in (null, again))
    assert abs(before - after) < 2.0 * ENOUGH and again.z == pytest.approx(null.z, abs=0.05)
