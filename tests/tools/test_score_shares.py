"""The shares of a score add up, the rule gives the aspects what it promises, and the page agrees with the weights."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from typing import Any

import pytest

from tests import other_vehicle
from tests.house import ROOT
from tools.measures.score_shares import (
    ASPECT_METRICS,
    AT_LIMIT,
    CALM,
    GROUPS,
    PREVIEW,
    SCORE,
    DrivenSet,
    is_complete,
    least_terms,
    mean_terms,
    share_rows,
    weights_by_rule,
)
from tunefree_hil.config.load import load_vehicle, load_weights
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.score import FINISHED, SCORE_METRICS, ScenarioGrade, weighted_mean
from tunefree_hil.grade.table import EFFORT, TABLE

DEFAULT = load_weights(ROOT / "bench_configs" / "weights" / "default.toml")
MOST_PERCENT = 25.0  # of a calm set's score in one metric


def graded(values: Mapping[str, float | None]) -> ScenarioGrade:
    metrics: dict[str, float | None] = {**dict.fromkeys(SCORE_METRICS, 0.0), **values}
    return ScenarioGrade("road", weighted_mean(metrics, DEFAULT), metrics, 0, FINISHED, 1000)


def driven(name: str, *roads: Mapping[str, float | None]) -> DrivenSet:
    return DrivenSet("car", name, {str(number): graded(values) for number, values in enumerate(roads)}, len(roads))


def values_of_a_set(factor: float) -> dict[str, float]:
    return {name: factor * (0.1 + 0.01 * number) for number, name in enumerate(DEFAULT.metrics)}


def test_terms_add_up_to_the_mean_score() -> None:
    """Also where a road has no start metric, and where a metric is beyond its largest value."""
    grades = [
        graded(values_of_a_set(1.0)),
        graded({**values_of_a_set(2.0), "start_overshoot": None}),
        graded({**values_of_a_set(1.0), "pedal_alternation": 50.0}),
    ]
    terms = mean_terms(grades, DEFAULT)
    assert sum(terms.values()) == pytest.approx(sum(grade.score for grade in grades) / 3.0)
    assert terms["pedal_alternation"] <= DEFAULT.largest_value * DEFAULT.metrics["pedal_alternation"]


def test_the_least_of_any_set_is_taken_by_road_and_metric() -> None:
    one = driven("a", {"lateral_rms_after_start": 0.3, "steer_rate_rms": 0.1}, {"lateral_rms_after_start": 0.1})
    other = driven("b", {"lateral_rms_after_start": 0.2, "steer_rate_rms": 0.4}, {"lateral_rms_after_start": 0.5})
    total = sum(DEFAULT.metrics.values())
    found = least_terms([one, other], DEFAULT)
    assert found["lateral_rms_after_start"] == pytest.approx(DEFAULT.metrics["lateral_rms_after_start"] / total * 0.15)
    assert found["steer_rate_rms"] == pytest.approx(DEFAULT.metrics["steer_rate_rms"] / total * 0.05)


def test_the_rule_gives_every_aspect_and_metric_its_share() -> None:
    """In the score of the median set; alternating pedals at their limit then cost what the effort costs."""
    sets = [driven(name, values_of_a_set(factor)) for name, factor in zip(CALM, (0.5, 1.0, 3.0), strict=True)]
    weights = weights_by_rule(sets)
    assert weights.keys() == DEFAULT.metrics.keys() and sum(weights.values()) == pytest.approx(100.0)
    parts = {name: weight * values_of_a_set(1.0)[name] for name, weight in weights.items() if name != AT_LIMIT}
    published = sum(ASPECT_METRICS.values())
    for aspect, groups in GROUPS.items():
        shares = [sum(parts[name] for name in group) / sum(parts.values()) for group in groups]
        assert shares == pytest.approx([ASPECT_METRICS[aspect] / published / len(groups)] * len(groups))
    effort = sum(parts[name] for group in GROUPS[EFFORT] for name in group)
    assert weights[AT_LIMIT] == pytest.approx(effort)


def test_every_weighed_metric_is_in_the_group_of_its_aspect() -> None:
    assert list(ASPECT_METRICS.values()) == [18, 5, 6, 6]
    for aspect, groups in GROUPS.items():
        assert {TABLE[name].aspect for group in groups for name in group} == {aspect}


def test_only_complete_drives_from_beside_their_road_count() -> None:
    whole = graded({"start_overshoot": 0.1})
    assert is_complete(whole)
    assert not is_complete(graded({"start_overshoot": None}))
    assert not is_complete(whole._replace(replans=1)) and not is_complete(whole._replace(outcome="left_lane"))


def test_rows_are_aspects_with_their_metrics_and_the_score() -> None:
    weights = WeightsSpec(
        schema="tunefree.weights/1", name="t", against="original",
        metrics={"steer_rate_rms": 1.0, "lateral_jerk_rms": 2.0, "pedal_rate_rms": 3.0},
    )  # fmt: skip
    column = {"steer_rate_rms": 10.0, "lateral_jerk_rms": 60.0, "pedal_rate_rms": 30.0, SCORE: 0.2}
    rows: list[dict[str, Any]] = share_rows({"car a": column}, weights)
    assert [(row["percent"], row["car a"]) for row in rows] == [
        ("**comfort**", 60.0), ("`lateral_jerk_rms`", 60.0), ("**effort**", 40.0), ("`steer_rate_rms`", 10.0),
        ("`pedal_rate_rms`", 30.0), (SCORE, 0.2),
    ]  # fmt: skip


def test_the_page_has_the_weights_of_the_file_and_no_metric_drowns_a_calm_set() -> None:
    with (ROOT / "docs" / "results" / "score_shares.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["percent"].startswith("`")]
    assert {row["percent"].strip("`"): float(row["weight"]) for row in rows} == DEFAULT.metrics
    first = load_vehicle(other_vehicle.FIRST).name  # the one whose shipped gains are calm with the plain controller
    calm = [name for name in rows[0] if name.endswith(f" {PREVIEW}") or name in [f"{first} {one}" for one in CALM]]
    assert len(calm) == 4
    assert max(float(row[name]) for row in rows for name in calm) <= MOST_PERCENT
