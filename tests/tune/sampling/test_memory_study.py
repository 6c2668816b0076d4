"""Remembered studies change no suggestion, whatever was asked before."""

from __future__ import annotations

import random
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tune.drive_study import SPACE, Parameter
from tests.tune.sampler_cases import CASES
from tunefree_hil.tune.sampling import ScoredPoint, suggest_point, suggest_points
from tunefree_hil.tune.sampling.memory_study import MOST_RETRACTED, MOST_STUDIES, MemoryStudy, StudyKind, StudyMemory
from tunefree_hil.tune.sampling.optuna_samplers import MEMORY
from tunefree_hil.tune.space import Space, make_space

OTHER = make_space([Parameter("lqr.q1", 0.01, 1.0), Parameter("station.kp", 0.01, 2.0)])


def trials(count: int, space: Space = SPACE, seed: int = 99) -> list[ScoredPoint]:
    drawn = [suggest_point(space, [], sampler="random", seed=seed, slot=slot) for slot in range(count)]
    return [ScoredPoint(values, round(sum(values.values()), 1), 0.1 * (k % 2)) for k, values in enumerate(drawn)]


class Question(NamedTuple):
    """One call: how many of the trials are finished, how many are in flight, how many points are asked for."""

    known: int
    pending: int
    count: int
    sampler: str
    is_other: bool

    def answer(self) -> list[dict[str, float]]:
        space, points = (OTHER, FAR) if self.is_other else (SPACE, NEAR)
        waiting = [point.parameters for point in points[self.known : self.known + self.pending]]
        slots = range(self.known + self.pending, self.known + self.pending + self.count)
        return suggest_points(space, points[: self.known], sampler=self.sampler, seed=4, slots=slots, pending=waiting)

    def cold_answer(self) -> list[dict[str, float]]:
        MEMORY.forget()
        return self.answer()


NEAR, FAR = trials(40), trials(40, OTHER)
QUESTIONS = st.builds(
    Question,
    known=st.integers(0, 32),
    pending=st.integers(0, 3),
    count=st.integers(1, 3),
    sampler=st.sampled_from(["tpe_independent", "tpe_relative", "nsga", "random"]),
    is_other=st.booleans(),
)


@settings(max_examples=25, deadline=None)
@given(questions=st.lists(QUESTIONS, min_size=2, max_size=6))
def test_an_answer_does_not_depend_on_the_questions_before_it(questions: list[Question]) -> None:
    """Longer and shorter histories, points in flight that are retracted, two studies in turn."""
    cold = [question.cold_answer() for question in questions]
    MEMORY.forget()
    assert [question.answer() for question in questions] == cold
    assert [question.answer() for question in reversed(questions)] == cold[::-1]


@pytest.mark.parametrize("sampler", CASES)
def test_a_search_in_steps_is_the_search_from_a_cold_start(sampler: str) -> None:
    for known in (12, 16, 15):
        question = Question(known, 2, 2, sampler, is_other=False)
        warm = question.answer()
        assert question.cold_answer() == warm


def test_other_trials_of_the_same_number_are_no_beginning() -> None:
    cold = Question(20, 0, 1, "tpe_independent", is_other=False).cold_answer()
    changed = [point._replace(score=5.0 - point.score) for point in NEAR[:20]]
    MEMORY.forget()
    suggest_points(SPACE, changed, sampler="tpe_independent", seed=4, slots=[20])
    assert Question(20, 0, 1, "tpe_independent", is_other=False).answer() == cold


def test_a_caller_may_change_the_trials_that_it_gave() -> None:
    points = trials(15)
    suggest_point(SPACE, points, sampler="tpe_independent", seed=4, slot=15)
    points[3].parameters["lqr.q1"] = 0.5
    warm = suggest_point(SPACE, points, sampler="tpe_independent", seed=4, slot=15)
    MEMORY.forget()
    assert suggest_point(SPACE, points, sampler="tpe_independent", seed=4, slot=15) == warm


def test_few_studies_are_remembered_and_worn_ones_are_not() -> None:
    memory, kind = StudyMemory(), StudyKind(SPACE, 1)
    for length in range(MOST_STUDIES + 3):
        with memory.open(kind, NEAR[length : length + 5]):
            pass
    assert len(memory._studies) == MOST_STUDIES
    with memory.open(kind, NEAR[:5]) as study:
        for _ in range(MOST_RETRACTED + 6):
            study.begin(NEAR[7].parameters)
    assert study.is_worn and study not in memory._studies


def test_a_study_that_failed_is_not_used_again() -> None:
    memory, kind = StudyMemory(), StudyKind(SPACE, 1)
    with pytest.raises(ZeroDivisionError), memory.open(kind, NEAR[:5]) as study:
        study.begin(NEAR[7].parameters)
        raise ZeroDivisionError
    with memory.open(kind, NEAR[:5]) as other:
        assert other is not study


@given(st.integers(0, 12), st.integers(0, 12))
def test_a_study_begins_a_history_that_is_longer_and_the_same(first: int, second: int) -> None:
    study = MemoryStudy(StudyKind(SPACE, 1))
    study.extend(NEAR[:first])
    assert study.begins(NEAR[:second]) is (first <= second)
    assert study.begins(random.Random(1).sample(NEAR, second)) is (first == 0)
