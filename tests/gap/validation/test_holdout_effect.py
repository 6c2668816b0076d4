"""What an effect does on blocks that prove: by the view that the others chose, and whether it shows there at all."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.gap.selection.test_criteria import BLOCKS, ROWS, model
from tunefree_hil.gap.validation.holdout_effect import ComparedModels, measure_holdout_effect
from tunefree_hil.gap.workers.worker import FitSummary

SEEN, PROOF = np.arange(BLOCKS - 4), np.arange(BLOCKS - 4, BLOCKS)
COUNTS = np.full(BLOCKS, ROWS)


def told(squares: list[float], slow: list[float] | None = None) -> FitSummary:
    """A model that misses target `a` by so much on the blocks that judged and on those that prove, one by one."""
    one = model("x", ROWS * np.array([*np.full(BLOCKS - 4, squares[0]), *squares[1:]]))
    if slow is None:
        return one
    return one._replace(
        averaged_squared_residuals={
            "a": (ROWS * np.array([*np.full(BLOCKS - 4, slow[0]), *np.full(4, slow[1])]), COUNTS)
        }
    )


def test_an_effect_that_is_there_takes_as_much_off_the_blocks_that_prove() -> None:
    null, after = told([4.0, 4.0, 4.0, 4.0, 4.0]), told([1.0, 1.0, 1.0, 1.0, 1.0])
    assert measure_holdout_effect(ComparedModels(null, after, null), "a", SEEN, PROOF) == pytest.approx(
        (0.5, 0.5, 0.75)
    )


def test_blocks_that_do_not_show_it_are_not_stirred_and_those_that_it_helps_and_spoils_are() -> None:
    null = told([4.0, 4.0, 4.0, 4.0, 4.0])
    silent = measure_holdout_effect(ComparedModels(null, told([1.0, 4.0, 4.0, 4.0, 4.0]), null), "a", SEEN, PROOF)
    torn = measure_holdout_effect(ComparedModels(null, told([1.0, 1.0, 7.0, 1.0, 7.0]), null), "a", SEEN, PROOF)
    assert silent.holdout_error_reduction == silent.effect_energy == 0.0
    assert abs(torn.holdout_error_reduction) < 1e-9 and torn.effect_energy == pytest.approx(0.75)


def test_the_proof_does_not_choose_how_it_is_looked_at() -> None:
    """Tick by tick it gets worse there, by means of a second better: the others were judged by ticks."""
    null, after = told([4.0, 4.0, 4.0, 4.0, 4.0], [4.0, 4.0]), told([1.0, 6.0, 6.0, 6.0, 6.0], [3.0, 1.0])
    found = measure_holdout_effect(ComparedModels(null, after, null), "a", SEEN, PROOF)
    assert found.fit_error_reduction == pytest.approx(0.5) and found.holdout_error_reduction < -0.2


def test_where_the_null_misses_next_to_nothing_it_is_held_against_what_it_misses_elsewhere() -> None:
    """A stop that the proof does not reach: what the rest of the fit does there is small, and no verdict."""
    null, after = told([100.0, 0.01, 0.01, 0.01, 0.01]), told([1.0, 0.04, 0.04, 0.04, 0.04])
    assert measure_holdout_effect(ComparedModels(null, after, null), "a", SEEN, PROOF) == pytest.approx(
        (0.9, -0.1, 0.03)
    )


def test_where_the_proof_has_nothing_of_the_signal_nothing_is_said() -> None:
    null, after = told([4.0, 0.0, 0.0, 0.0, 0.0]), told([1.0, 0.0, 0.0, 0.0, 0.0])
    found = measure_holdout_effect(ComparedModels(null, after, null), "a", SEEN, PROOF)
    assert (
        found.fit_error_reduction == pytest.approx(0.5)
        and math.isnan(found.holdout_error_reduction)
        and math.isnan(found.effect_energy)
    )
