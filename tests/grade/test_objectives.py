"""The two parts of a score: what counts in which, and that a failure or a re-plan is bad in both."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_weights
from tunefree_hil.grade.objectives import (
    OBJECTIVES,
    choose_objectives,
    grades_by_objective,
    measure_objective,
    measure_objectives,
    metrics_of_objective,
)
from tunefree_hil.grade.score import ScenarioGrade, weighted_mean

DEFAULT = load_weights("default")
NAMES = tuple(OBJECTIVES)


def drive(value: float = 0.2, **more: Any) -> dict[str, Any]:
    """A drive whose metrics all have one value."""
    grade = ScenarioGrade("bend", 0.0, dict.fromkeys(DEFAULT.metrics, value), 0, "finished", 100)
    return {**grade._asdict(), **more}


def test_every_weighed_metric_is_in_one_objective() -> None:
    tracking, comfort = (metrics_of_objective(name, DEFAULT) for name in NAMES)
    assert {**tracking, **comfort} == DEFAULT.metrics and not set(tracking) & set(comfort)
    assert "lateral_peak_after_start" in tracking and {"steer_rate_rms", "longitudinal_jerk_rms"} <= set(comfort)


@given(st.dictionaries(st.sampled_from(sorted(DEFAULT.metrics)), st.floats(0.0, 9.0), max_size=13))
def test_both_parts_with_their_weights_are_the_score(values: dict[str, float]) -> None:
    metrics = {**dict.fromkeys(DEFAULT.metrics, 0.5), **values}
    weights = [math.fsum(metrics_of_objective(name, DEFAULT).values()) for name in NAMES]
    parts = measure_objectives({"bend": drive(metrics=metrics)}, DEFAULT, NAMES)
    mean = sum(w * part for w, part in zip(weights, parts, strict=True)) / sum(weights)
    assert mean == pytest.approx(weighted_mean(dict(metrics), DEFAULT))


def test_one_part_does_not_see_the_other() -> None:
    jerky = drive(metrics={**drive()["metrics"], "steer_rate_rms": 2.0})
    assert measure_objective(jerky, DEFAULT, "tracking") == measure_objective(drive(), DEFAULT, "tracking")
    worse, before = (measure_objective(one, DEFAULT, "comfort") for one in (jerky, drive()))
    assert worse is not None and before is not None and worse > before


@pytest.mark.parametrize("name", NAMES)
def test_replans_and_failures_count_in_both(name: str) -> None:
    assert measure_objective(drive(replans=2), DEFAULT, name) == pytest.approx(2.2)
    assert measure_objective(drive(replans=99), DEFAULT, name) == 10.0
    assert measure_objective(drive(outcome="left_lane", metrics={}), DEFAULT, name) == 10.0


def test_a_metric_that_is_not_available_has_no_share() -> None:
    assert measure_objective(drive(metrics={"steer_rate_rms": 0.3, "pedal_rate_rms": None}), DEFAULT, "comfort") == 0.3
    short = drive(metrics={"steer_rate_rms": 0.3})
    assert measure_objective(short, DEFAULT, "tracking") is None
    assert measure_objectives({"short": short, "bend": drive()}, DEFAULT, NAMES) == pytest.approx((0.2, 0.25))
    grade = ScenarioGrade(**short)
    assert grades_by_objective([grade, ScenarioGrade(**drive())], DEFAULT, "tracking")[0].score == pytest.approx(0.2)
    for measure in (lambda: measure_objectives({"short": short}, DEFAULT, NAMES),
                    lambda: grades_by_objective([grade], DEFAULT, "tracking")):  # fmt: skip
        with pytest.raises(InputError, match="no drive has a metric of tracking"):
            measure()


def test_drives_are_combined_by_their_planned_samples() -> None:
    drives = {"a": drive(0.1, planned_samples=300), "b": drive(0.5), "b (other cars)": drive(9.0, planned_samples=0)}
    assert measure_objectives(drives, DEFAULT, NAMES) == pytest.approx((0.2, 0.2))
    grades = [ScenarioGrade(**drives["a"]), ScenarioGrade(**drives["b"])]
    assert [grade.score for grade in grades_by_objective(grades, DEFAULT, "comfort")] == pytest.approx([0.1, 0.5])


def test_what_is_asked_for_is_both_or_none() -> None:
    assert choose_objectives([], DEFAULT, "b.toml") == ()
    assert choose_objectives(["comfort", "tracking"], DEFAULT, "b.toml") == NAMES
    for names in (["comfort"], ["comfort", "comfort"], ["tracking", "speed"]):
        with pytest.raises(InputError, match="tracking, comfort together") as caught:
            choose_objectives(names, DEFAULT, "b.toml")
        assert caught.value.key == "tune.objectives" and caught.value.file == "b.toml"


def test_weights_that_weigh_no_comfort_are_refused() -> None:
    paper = load_weights("paper")
    with pytest.raises(InputError, match="no metric of comfort or effort") as caught:
        choose_objectives(NAMES, paper, "b.toml")
    assert Path(caught.value.file).name == "paper.toml" and choose_objectives([], paper, "") == ()
