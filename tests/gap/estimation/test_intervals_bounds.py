"""What recalibration would move further than it may is told by what that would gain."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.gap.estimation.evidence import LEAST_NATS
from tunefree_hil.gap.estimation.intervals import held_back
from tunefree_hil.gap.estimation.least_squares import Fitted, Free, Sums
from tunefree_hil.gap.estimation.noise import Colour

KEYS = ("brake_gain.gain_frac", "grade.grade_rad", "steer_lag.tau_s")
LAG = Free(KEYS[2], 0.0, 0.5, False, 0.0, 0.0, 1.35)
BLOCKS = np.arange(4)


def fitted(z: tuple[float, float, float], target: tuple[float, float], proof: float = 0.0) -> Fitted:
    """Two numbers of recalibration's whose squares would be least at `target`, and an effect's; a block that proves
    pulls at the first.
    """
    curve = np.diag([100.0, 100.0, 100.0]) / len(BLOCKS)
    away = np.array([z[0] - target[0], z[1] - target[1], 0.0])
    slope = np.tile(curve @ away, (len(BLOCKS) + 1, 1))
    slope[-1] = (proof, 0.0, 0.0)
    count = len(BLOCKS) + 1
    sums = Sums(np.arange(3), np.ones(count), slope, np.tile(curve, (count, 1, 1)), np.full(count, 50.0),
                Colour(np.array([1.0]), 1.0, 1.0))  # fmt: skip
    return Fitted("x", KEYS, np.array(z), (LAG,), {}, np.diag([1.0, 1.0, 0.0]), {"speed": sums}, {})


def test_what_is_held_at_its_end_is_told_with_what_it_would_gain_the_most_first() -> None:
    found = held_back(fitted((2.0, -2.0, 0.3), (2.6, -4.0)), BLOCKS)
    assert [one.key for one in found] == [KEYS[1], KEYS[0]]
    assert found[0].nats == pytest.approx(0.5 * (100.0 * 2.0 - 2.0) ** 2 / 101.0), "the prior's own pull taken off"
    assert found[0].words == "recalibration moves grade.grade_rad by -2.0 standard deviations"


@pytest.mark.parametrize(
    ("z", "target"),
    [((0.0, 0.0, 0.3), (0.0, 0.0)), ((1.5, -1.5, 0.3), (4.0, -4.0)), ((2.0, 2.0, 0.3), (2.1, 1.0))],
    ids=["at rest", "on its way", "hardly pulled at, and pulled back"],
)
def test_what_may_still_move_or_would_gain_nothing_is_not_told(
    z: tuple[float, float, float], target: tuple[float, float]
) -> None:
    assert held_back(fitted(z, target), BLOCKS) == []


def test_an_effect_at_its_end_is_no_recalibration_and_blocks_that_prove_are_not_looked_at() -> None:
    assert held_back(fitted((0.0, 0.0, 2.0), (0.0, 0.0)), BLOCKS) == []
    assert held_back(fitted((2.0, 0.0, 0.3), (2.0, 0.0), proof=-1e4), BLOCKS) == []
    assert LEAST_NATS > 0.0
