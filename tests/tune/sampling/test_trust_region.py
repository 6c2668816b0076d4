"""COBYQA beside TPE: one function of the trials, no point twice, far down within few trials."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from tests.tune.sampling.test_cma import BOWL, bowl
from tunefree_hil.tune.sampling import ScoredPoint, suggest_points
from tunefree_hil.tune.sampling.points import from_unit
from tunefree_hil.tune.sampling.trust_region import CRITERIA, SEARCHES, LocalSearch, suggest_local_points

GIVEN = [from_unit(BOWL, np.full(6, share)) for share in (0.8, 0.75)]
N_FIRST_MODEL = 2 * 6 + 1


def told_given() -> list[ScoredPoint]:
    return [bowl(values) for values in GIVEN]


def search(trials: int, in_flight: int = 1, sampler: str = "trust_region") -> list[ScoredPoint]:
    told = told_given()
    while len(told) < trials:
        slots = range(len(told), len(told) + in_flight)
        drawn = suggest_points(BOWL, told, sampler=sampler, seed=3, slots=slots, given=len(GIVEN))
        told += [bowl(values) for values in drawn]
    return told


def best(told: Sequence[ScoredPoint]) -> float:
    return min(point.score for point in told)


def test_the_first_model_depends_on_no_score() -> None:
    SEARCHES.forget()  # SciPy runs one COBYQA at a time
    models = []
    for sign in (1.0, -1.0):
        local, units = LocalSearch(np.full(4, 0.3)), []
        for k in range(2 * 4 + 1):
            assert local.point is not None
            units.append(tuple(local.point))
            local.tell((), sign * math.cos(7.0 * k))
        local.close()
        models.append(units)
    assert models[0] == models[1] and len(set(models[0])) == 2 * 4 + 1


def test_it_starts_at_the_best_given_trial_once_all_are_known() -> None:
    assert suggest_local_points(BOWL, told_given()[:1], given=2, count=4) == []
    units = SEARCHES.first_model_units(tuple(np.full(6, 0.75)))
    radius = CRITERIA.first_radius
    assert all(np.abs(unit - 0.75).max() <= 1.001 * radius for unit in units)
    drawn = suggest_local_points(BOWL, told_given(), given=2, count=50)
    # the start itself is known already
    assert len(drawn) == N_FIRST_MODEL - 1 and GIVEN[1] not in drawn


def test_points_in_flight_are_not_suggested_again() -> None:
    first = suggest_local_points(BOWL, told_given(), given=2, count=4)
    second = suggest_local_points(BOWL, told_given(), given=2, count=50, pending=first)
    assert len(second) == N_FIRST_MODEL - 1 - 4 and not [values for values in second if values in first]
    told = search(2 + N_FIRST_MODEL - 1)
    (waiting,) = suggest_local_points(BOWL, told, given=2, count=8)
    assert suggest_local_points(BOWL, told, given=2, count=8, pending=[waiting]) == []
    drawn = suggest_points(
        BOWL, told, sampler="trust_region", seed=3, slots=range(14, 18), pending=[waiting], given=2
    )  # of TPE
    assert len(drawn) == 4 and waiting not in drawn


@pytest.mark.parametrize("in_flight", [1, 8])
def test_a_suggestion_is_the_same_in_a_new_process(in_flight: int) -> None:
    told = search(60, in_flight)
    for length in (2, 9, 17, 33, 57):
        slots = range(length, length + in_flight)
        asked = []
        for _ in range(2):
            SEARCHES.forget()
            asked.append(suggest_points(BOWL, told[:length], sampler="trust_region", seed=3, slots=slots, given=2))
        # after a longer history, too
        suggest_points(BOWL, told, sampler="trust_region", seed=3, slots=[60], given=2)
        asked.append(suggest_points(BOWL, told[:length], sampler="trust_region", seed=3, slots=slots, given=2))
        assert asked[0] == asked[1] == asked[2]


def test_another_score_leads_elsewhere() -> None:
    told = search(30)
    changed = [*told[:20], told[20]._replace(score=3.0 * told[20].score), *told[21:]]
    after = [
        suggest_points(BOWL, points, sampler="trust_region", seed=3, slots=[30], given=2) for points in (told, changed)
    ]
    assert after[0] != after[1]


def test_it_is_far_down_within_few_trials() -> None:
    local, tpe = search(50), search(50, sampler="tpe_independent")
    assert best(local) - 0.1 < 0.1 * (best(tpe) - 0.1)


def test_a_converged_search_goes_on_with_tpe_and_begins_again() -> None:
    told = search(260)
    values = [tuple(point.parameters.values()) for point in told]
    starts = {start for _, start in SEARCHES._converged}
    assert len(starts) >= 1 and len(set(values)) > 200
    assert best(told) < 0.1001
