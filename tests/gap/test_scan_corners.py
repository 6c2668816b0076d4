"""Grids of a limit, whose corners are loud by the noise of the smooth miss that it takes away."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.gap.estimation.test_grid import BENT, ROWS, WIND, Problem, T, Work, scan
from tunefree_hil.gap.estimation.grid import EVEN, Scan
from tunefree_hil.gap.estimation.least_squares import Slopes
from tunefree_hil.gap.estimation.noise import Colour


class Corners(Work):
    """A smooth miss, of which a limit near 0.5 takes off nearly all and leaves corners; noise hears corners alone."""

    def residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        near = max(0.0, 1.0 - abs(values.get("limit.size", 1.0) - 0.5) / 0.2)
        rough = 0.9 * np.sign(np.sin(150.0 * T))
        return {"x": [(1.0 - 0.95 * near) * BENT + near**0.5 * rough + 3.0 * T * values.get("a", 0.0)]}

    def white(self, name: str, residual: list[np.ndarray], colour: Colour) -> tuple[np.ndarray, np.ndarray]:
        return 3.0 * np.diff(residual[0], axis=0, prepend=residual[0][:1]), np.zeros(ROWS, dtype=np.int64)


class Cornered(Problem):
    """A question about that."""

    work = Corners()


def test_who_takes_most_off_is_fitted_though_its_noise_is_louder() -> None:
    limit = WIND._replace(key="limit.size")
    problem: Any = Cornered()
    start = scan().start._replace(residuals=problem.work.residuals({}))
    one = Scan(problem, start, Slopes({"x": (np.array([0]), [3.0 * T[:, None]])}))
    found = one.best([limit])
    assert found.gain == pytest.approx(0.0, abs=1e-6), "by the noise of what is missed nothing is gained anywhere"
    assert found.closer is not None and abs(found.closer.z[-1] - 0.5) < 1.0 / EVEN and found.worth == np.inf
    nearer = one.nearer([limit], found.closer)
    assert abs(nearer.z[-1] - 0.5) <= abs(found.closer.z[-1] - 0.5) + 1e-9
    assert scan().best([WIND]).closer is None, "where the best point takes most off there is no other"
