"""Nuisances at their bounds, with the gain beyond them."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.gap.estimation.evidence import MIN_EVIDENCE_NATS
from tunefree_hil.gap.estimation.intervals import find_parameters_at_bound
from tunefree_hil.gap.estimation.least_squares import Fit, FreeParameter, NormalEquations
from tunefree_hil.gap.estimation.noise import NoiseModel

KEYS = ("brake_gain.gain_frac", "grade.grade_rad", "steer_lag.tau_s")
LAG = FreeParameter(KEYS[2], 0.0, 0.5, False, 0.0, 0.0, 1.35)
BLOCKS = np.arange(4)


def fitted(z: tuple[float, float, float], target: tuple[float, float], proof: float = 0.0) -> Fit:
    """Two numbers of recalibration's whose squares would be least at `target`, and an effect's; a block that proves
    pulls at the first.
    """
    curve = np.diag([100.0, 100.0, 100.0]) / len(BLOCKS)
    away = np.array([z[0] - target[0], z[1] - target[1], 0.0])
    slope = np.tile(curve @ away, (len(BLOCKS) + 1, 1))
    slope[-1] = (proof, 0.0, 0.0)
    count = len(BLOCKS) + 1
    sums = NormalEquations(np.arange(3), np.ones(count), slope, np.tile(curve, (count, 1, 1)), np.full(count, 50.0),
                NoiseModel(np.array([1.0]), 1.0, 1.0))  # fmt: skip
    return Fit("x", KEYS, np.array(z), (LAG,), {}, np.diag([1.0, 1.0, 0.0]), {"speed": sums}, {})


def test_parameters_at_their_bounds_are_reported_with_their_gain_largest_first() -> None:
    found = find_parameters_at_bound(fitted((2.0, -2.0, 0.3), (2.6, -4.0)), BLOCKS)
    assert [one.key for one in found] == [KEYS[1], KEYS[0]]
    assert found[0].nats == pytest.approx(0.5 * (100.0 * 2.0 - 2.0) ** 2 / 101.0), "without the gradient of the prior"
    assert found[0].text == "recalibration moves grade.grade_rad by -2.0 standard deviations"


@pytest.mark.parametrize(
    ("z", "target"),
    [((0.0, 0.0, 0.3), (0.0, 0.0)), ((1.5, -1.5, 0.3), (4.0, -4.0)), ((2.0, 2.0, 0.3), (2.1, 1.0))],
    ids=["at rest", "on its way", "hardly pulled at, and pulled back"],
)
def test_parameters_that_may_move_or_would_gain_nothing_are_not_reported(
    z: tuple[float, float, float], target: tuple[float, float]
) -> None:
    assert find_parameters_at_bound(fitted(z, target), BLOCKS) == []


def test_effects_at_their_bounds_and_holdout_blocks_do_not_count() -> None:
    assert find_parameters_at_bound(fitted((0.0, 0.0, 2.0), (0.0, 0.0)), BLOCKS) == []
    assert find_parameters_at_bound(fitted((2.0, 0.0, 0.3), (2.0, 0.0), proof=-1e4), BLOCKS) == []
    assert MIN_EVIDENCE_NATS > 0.0
