"""A fit goes on until nothing is gained: on one key whose slope goes flat on the way, so that no step gets there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tunefree_hil.gap.estimation.gauss_newton import ENOUGH, fit_null, fit_on, fit_without
from tunefree_hil.gap.estimation.least_squares import MOST_TOGETHER, SLACK, Fitted, Free, Problem, cost_of
from tunefree_hil.gap.estimation.noise import Colour
from tunefree_hil.gap.estimation.nuisance import Nuisance

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


class Two(Flat):
    """One target that feels two numbers by themselves, known together far better than each."""

    R = 0.98
    TRUTH = (-2.0, 2.0)
    keys = ("a", "b")

    def residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        rows = np.random.default_rng(7).standard_normal((400, 2))
        off = [values[key] - truth for key, truth in zip(self.keys, self.TRUTH, strict=True)]
        return {"a": [rows @ off + 0.3 * np.random.default_rng(8).standard_normal(400)]}


def test_a_model_whose_effect_is_gone_is_recalibrated_within_what_the_null_may_do() -> None:
    """Beside the effect the other number had gone far; from there each step back inside costs."""
    some = [Nuisance(key, 0.0, 1.0) for key in Two.keys]
    together = np.array([[1.0, Two.R], [Two.R, 1.0]])
    asked = Problem(cast(Any, Two()), some, together, known=True)
    null, _ = fit_null(asked)
    free = (Free("a", -4.0, 4.0, False, 0.0, 0.0, 1.0),)
    keys, z = ("b", "a"), np.array([2.0, free[0].place(-2.0)])
    values = asked.values(keys, z, free)
    residuals = asked.work.residuals(values)
    columns = asked.slopes(keys, z, free, [0, 1], residuals)
    sums = asked.sums(residuals, columns, asked.colours(residuals))
    beside = Fitted("a", keys, z, free, values, asked.prior(keys, free), sums, residuals)
    without = fit_without(asked, beside, "a")
    far = np.abs(asked.walls(without.keys, ()) @ without.z).max()
    assert far <= 1.001 * SLACK * MOST_TOGETHER
    assert without.z == pytest.approx([null.z[null.keys.index(key)] for key in without.keys], abs=0.05)
