"""Grids of a limit, whose corners are large in units of the smooth residual that it removes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.gap.estimation.test_grid import BENT, ROWS, WIND, FakeProblem, FakeResidualModel, T, scan
from tunefree_hil.gap.estimation.grid import CRITERIA, GridScan
from tunefree_hil.gap.estimation.least_squares import Jacobian
from tunefree_hil.gap.estimation.noise import NoiseModel


class Corners(FakeResidualModel):
    """A smooth residual; a limit near 0.5 removes nearly all of it and leaves corners, which whitening enlarges."""

    def simulate_residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        near = max(0.0, 1.0 - abs(values.get("limit.size", 1.0) - 0.5) / 0.2)
        rough = 0.9 * np.sign(np.sin(150.0 * T))
        return {"x": [(1.0 - 0.95 * near) * BENT + near**0.5 * rough + 3.0 * T * values.get("a", 0.0)]}

    def whiten(self, name: str, residual: list[np.ndarray], colour: NoiseModel) -> tuple[np.ndarray, np.ndarray]:
        return 3.0 * np.diff(residual[0], axis=0, prepend=residual[0][:1]), np.zeros(ROWS, dtype=np.int64)


class Cornered(FakeProblem):
    """A problem with that residual."""

    residual_model = Corners()


def test_the_point_that_removes_most_is_an_alternative_though_its_noise_is_larger() -> None:
    limit = WIND._replace(key="limit.size")
    problem: Any = Cornered()
    start = scan().base._replace(residuals=problem.residual_model.simulate_residuals({}))
    one = GridScan(problem, start, Jacobian({"x": (np.array([0]), [3.0 * T[:, None]])}))
    found = one.find_start([limit])
    assert found.gain == pytest.approx(0.0, abs=1e-6), "under the noise of the residual no point gains"
    assert (
        found.alternative is not None
        and abs(found.alternative.z[-1] - 0.5) < 1.0 / CRITERIA.linear_points
        and found.priority == np.inf
    )
    nearer = one.refine_alternative([limit], found.alternative)
    assert abs(nearer.z[-1] - 0.5) <= abs(found.alternative.z[-1] - 0.5) + 1e-9
    assert scan().find_start([WIND]).alternative is None, "no alternative where the best point removes most"
