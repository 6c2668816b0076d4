"""The terms of a score add up to it, and those of a difference to the difference, whatever happened in the drives."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.difference import FAILURE, REPLANS, score_difference, score_terms
from tunefree_hil.grade.metrics import METRICS
from tunefree_hil.grade.score import FINISHED, ScenarioGrade, combine_scores, weighted_mean

NAMES = list(METRICS)
WEIGHTS = WeightsSpec(
    schema="tunefree.weights/1",
    name="t",
    against="original",
    metrics={name: float(i % 4) for i, name in enumerate(NAMES)},
)


def graded(name: str, values: list[float | None], replans: int, outcome: str, planned: int) -> ScenarioGrade:
    """As grade() scores them."""
    metrics = dict(zip(NAMES, values, strict=True))
    score = WEIGHTS.failure_score
    if outcome == FINISHED:
        score = min(weighted_mean(metrics, WEIGHTS) + WEIGHTS.replan_penalty * replans, score)
    return ScenarioGrade(name, score, metrics, replans, outcome, planned)


value = st.one_of(st.none(), st.floats(0.0, 3.0))


@st.composite
def candidates(draw: st.DrawFn) -> list[ScenarioGrade]:
    grades = []
    for i in range(3):
        values = [1.0, 0.5, *draw(st.lists(value, min_size=len(NAMES) - 2, max_size=len(NAMES) - 2))]
        outcome = draw(st.sampled_from([FINISHED, FINISHED, "left_lane"]))
        grades.append(graded(f"s{i}", values, draw(st.integers(0, 12)), outcome, 1000 * (i + 1)))
    return grades


def plain(grades: list[ScenarioGrade]) -> dict[str, Any]:
    return {one.scenario: one._asdict() for one in grades}


@given(candidates())
def test_terms_add_up_to_the_score(grades: list[ScenarioGrade]) -> None:
    terms = score_terms(plain(grades), WEIGHTS)
    assert sum(sum(row.values()) for row in terms.values()) == pytest.approx(combine_scores(grades), rel=1e-12)


@given(candidates(), candidates())
def test_cells_add_up_to_the_difference(first: list[ScenarioGrade], other: list[ScenarioGrade]) -> None:
    apart = score_difference(plain(first), plain(other), WEIGHTS)
    assert apart.total == pytest.approx(combine_scores(other) - combine_scores(first), rel=1e-9, abs=1e-12)
    assert sum(apart.scenarios.values()) == pytest.approx(apart.total, rel=1e-9, abs=1e-12)
    back = score_difference(plain(other), plain(first), WEIGHTS)
    assert back.total == pytest.approx(-apart.total)


def test_what_a_term_is() -> None:
    """One scenario, two weights: 2 x 0.3 / 3, 1 x 0.6 / 3, one re-plan."""
    weights = WeightsSpec(
        schema="tunefree.weights/1", name="t", against="original",
        metrics={"lateral_err_peak": 2.0, "speed_err_peak": 1.0, "station_err_peak": 0.0},
    )  # fmt: skip
    drive = {"metrics": {"lateral_err_peak": 0.3, "speed_err_peak": 0.6}, "replans": 1, "outcome": FINISHED}
    (row,) = score_terms({"a": {**drive, "score": 1.4, "planned_samples": 10}}, weights).values()
    assert row == pytest.approx({"lateral_err_peak": 0.2, "speed_err_peak": 0.2, REPLANS: 1.0, FAILURE: 0.0})
    (row,) = score_terms(
        {"a": {**drive, "outcome": "left_lane", "score": 10.0, "planned_samples": 10}}, weights
    ).values()
    assert row == {"lateral_err_peak": 0.0, "speed_err_peak": 0.0, REPLANS: 0.0, FAILURE: 10.0}
    (row,) = score_terms({"a": {**drive, "replans": 12, "score": 10.0, "planned_samples": 10}}, weights).values()
    assert row[REPLANS] == 12.0 and row[FAILURE] == pytest.approx(-2.4), "the cap"


def test_terms_count_a_metric_up_to_its_largest_value() -> None:
    """What is beyond it is in no term, nor in the one of failures."""
    capped = replace(WEIGHTS, largest_value=2.0)
    metrics: dict[str, float | None] = {**dict.fromkeys(NAMES, 0.0), NAMES[1]: 50.0}
    grade = ScenarioGrade("s", weighted_mean(metrics, capped), metrics, 0, FINISHED, 1000)
    terms = score_terms(plain([grade]), capped)["s"]
    assert terms[NAMES[1]] == pytest.approx(grade.score) and terms[FAILURE] == 0.0
