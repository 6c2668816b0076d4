"""A fit goes on until nothing is gained, on a parameter whose derivative vanishes at the solution."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tunefree_hil.gap.estimation.gauss_newton import CRITERIA, fit_recalibration, fit_without_effect, refine_fit
from tunefree_hil.gap.estimation.least_squares import (
    JOINT_BOUND_SLACK,
    MAX_JOINT_SIGMA,
    Fit,
    FreeParameter,
    LeastSquaresProblem,
    penalised_cost,
)
from tunefree_hil.gap.estimation.noise import NoiseModel
from tunefree_hil.gap.estimation.nuisance import Nuisance

KEY, TRUTH, FLOOR = "drive.gain", 1.5, 1e-3
NOISE = FLOOR * np.random.default_rng(3).standard_normal(400)


class Flat:
    """One target, whose residual is the cube of the error of the key: each step goes a third of the way."""

    blocks = SimpleNamespace(count=2, roles=np.array(["fit", "choose"]))

    def simulate_residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        return {"a": [(values[KEY] - TRUTH) ** 3 + NOISE]}

    def whiten(self, name: str, joint: list[np.ndarray], colour: NoiseModel) -> tuple[np.ndarray, np.ndarray]:
        rows = np.concatenate(joint) / colour.sigma
        return rows, np.arange(len(rows)) % 2

    def estimate_noise(self, name: str, residual: list[np.ndarray]) -> NoiseModel:
        return NoiseModel(np.array([1.0]), float(np.sqrt(np.mean(residual[0] ** 2))), 1.0)


def problem() -> LeastSquaresProblem:
    return LeastSquaresProblem(cast(Any, Flat()), [Nuisance(KEY, 0.0, 1.0)])


def test_recalibration_ends_at_the_minimum_under_the_noise_of_its_residual() -> None:
    """Larger noise on the way hides how much is left to gain."""
    asked = problem()
    null, _ = fit_recalibration(asked)
    left = float(np.sqrt(np.mean(np.concatenate(null.residuals["a"]) ** 2)))
    assert left == pytest.approx(FLOOR, rel=0.05)
    again = refine_fit(asked, null)
    blocks = asked.non_holdout_blocks()
    before, after = (penalised_cost(null.equations, one.z, null.prior_precision, blocks) for one in (null, again))
    assert abs(before - after) < 2.0 * CRITERIA.min_cost_drop and again.z == pytest.approx(null.z, abs=0.05)


class Two(Flat):
    """One target that depends on two parameters, of which a combination is known far better than each."""

    R = 0.98
    TRUTH = (-2.0, 2.0)
    keys = ("a", "b")

    def simulate_residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        rows = np.random.default_rng(7).standard_normal((400, 2))
        off = [values[key] - truth for key, truth in zip(self.keys, self.TRUTH, strict=True)]
        return {"a": [rows @ off + 0.3 * np.random.default_rng(8).standard_normal(400)]}


def test_a_model_without_its_effect_is_refitted_within_the_joint_bounds() -> None:
    """Beside the effect the other parameter had moved far; from there each step back inside costs."""
    some = [Nuisance(key, 0.0, 1.0) for key in Two.keys]
    together = np.array([[1.0, Two.R], [Two.R, 1.0]])
    asked = LeastSquaresProblem(cast(Any, Two()), some, together, has_calibration_prior=True)
    null, _ = fit_recalibration(asked)
    free = (FreeParameter("a", -4.0, 4.0, False, 0.0, 0.0, 1.0),)
    keys, z = ("b", "a"), np.array([2.0, free[0].u_from_value(-2.0)])
    values = asked.parameter_values(keys, z, free)
    residuals = asked.residual_model.simulate_residuals(values)
    columns = asked.jacobian(keys, z, free, [0, 1], residuals)
    sums = asked.normal_equations(residuals, columns, asked.noise_models(residuals))
    beside = Fit("a", keys, z, free, values, asked.prior_precision(keys, free), sums, residuals)
    without = fit_without_effect(asked, beside, "a")
    far = np.abs(asked.joint_bounds(without.keys, ()) @ without.z).max()
    assert far <= 1.001 * JOINT_BOUND_SLACK * MAX_JOINT_SIGMA
    assert without.z == pytest.approx([null.z[null.keys.index(key)] for key in without.keys], abs=0.05)
