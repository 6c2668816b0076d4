"""The division of the trials that is made once gives the suggestions of Optuna's own sampler."""

from __future__ import annotations

import optuna
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from optuna.samplers import TPESampler

from tests.tune.drive_study import SPACE
from tunefree_hil.tune.sampling import ScoredPoint, suggest_point
from tunefree_hil.tune.sampling.memory_study import MemoryStudy, StudyKind, list_searched
from tunefree_hil.tune.sampling.tpe import TESTED_OPTUNA, SingleSplitTpe, make_tpe_sampler


def trials(count: int, objectives: int, *, limited: bool) -> list[ScoredPoint]:
    points = []
    for slot in range(count):
        values = suggest_point(SPACE, [], sampler="random", seed=5, slot=slot)
        several = tuple(0.1 + abs(values["lqr.q1"] - 0.3 * k) for k in range(objectives)) if objectives > 1 else ()
        violation = 0.2 * (slot % 4) if limited else None
        points.append(ScoredPoint(values, round(sum(values.values()), 1), violation, several))
    return points


@settings(max_examples=40, deadline=None)
@given(
    count=st.integers(0, 40),
    waiting=st.integers(0, 3),
    seed=st.integers(0, 2**32 - 1),
    relative=st.booleans(),
    limited=st.booleans(),
    objectives=st.sampled_from([1, 1, 2]),
)
def test_suggestions_are_those_of_the_plain_sampler(
    count: int, waiting: int, seed: int, relative: bool, limited: bool, objectives: int
) -> None:
    points = trials(count + waiting, objectives, limited=limited)
    asked = []
    for is_plain in (False, True):
        study = MemoryStudy(StudyKind(SPACE, objectives))
        study.extend(points[:count])
        for point in points[count:]:
            study.begin(point.parameters)
        sampler = make_tpe_sampler(seed, study.distributions, relative=relative, in_flight=waiting > 0)
        assert isinstance(sampler, SingleSplitTpe)
        plain = TPESampler(seed=seed, multivariate=relative, constant_liar=waiting > 0)
        asked.append(study.ask(plain if is_plain else sampler))
    assert asked[0] == asked[1]


def test_the_optuna_of_this_machine_was_tested() -> None:
    """Where it fails: run the test above with the new version, and raise TESTED_OPTUNA."""
    assert optuna.__version__.startswith(TESTED_OPTUNA)


def test_another_optuna_gets_the_plain_sampler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(optuna, "__version__", "5.1.0")
    sampler = make_tpe_sampler(1, {}, relative=True, in_flight=False)
    assert type(sampler) is TPESampler


def test_what_has_one_value_is_not_searched() -> None:
    float_, fixed = optuna.distributions.FloatDistribution(0.0, 1.0), optuna.distributions.IntDistribution(3, 3)
    assert list_searched({"b": float_, "c": fixed, "a": float_}) == {"a": float_, "b": float_}
