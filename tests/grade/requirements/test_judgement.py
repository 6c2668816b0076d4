"""Limits of a vehicle and of a bench file, and what drives are judged by them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.house import ROOT
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import LimitsSpec
from tunefree_hil.config.tuning.require_schema import REQUIREMENTS, RequireSpec
from tunefree_hil.grade.requirements.judgement import (
    judge_drives,
    measure_violation,
    not_judged_text,
    oscillates,
    violation_text,
)
from tunefree_hil.grade.requirements.limits import CRITERIA, default_limits, requirement_limits

LIMITS = {"lateral_error_peak_m": 0.5, "steer_oscillation_rad": 0.05, "replans": 0.0}


def drive(lateral_m: float | None = 0.1, wheel_rad: float | None = 0.01, replans: float = 0.0, **more: object) -> dict:
    values = {"lateral_error_peak_m": lateral_m, "steer_oscillation_rad": wheel_rad, "replans": replans}
    return {"outcome": "finished", "requirements": values, **more}


@pytest.mark.parametrize("path", sorted((ROOT / "dbc").glob("*/vehicle.toml")), ids=lambda path: path.parent.name)
def test_every_requirement_has_a_default(path: Path) -> None:
    limits = default_limits(load_vehicle(path.parent).limits)
    assert tuple(limits) == REQUIREMENTS
    assert all(limit > 0.0 for key, limit in limits.items() if key != "replans") and limits["replans"] == 0.0


def test_the_bench_file_comes_before_the_vehicle_and_inf_switches_off() -> None:
    vehicle = LimitsSpec(steer_rad=8.0, steer_rate_radps=10.0, throttle_frac=1.0, brake_frac=1.0)
    assert requirement_limits(vehicle, None)["steer_rate_peak_radps"] == pytest.approx(9.8)
    stated = RequireSpec(steer_rate_peak_radps=4.0, replans=math.inf)
    limits = requirement_limits(vehicle, stated)
    assert limits["steer_rate_peak_radps"] == 4.0 and "replans" not in limits
    assert list(limits) == [name for name in REQUIREMENTS if name != "replans"]


def test_the_worst_road_of_each_requirement_is_named() -> None:
    judged = judge_drives({"bend": drive(0.3), "lane_change": drive(0.1, 1.02), "hill": drive(0.6, 0.06)}, LIMITS)
    worst = {result.name: (result.value, result.road) for result in judged.results}
    assert worst["lateral_error_peak_m"] == (0.6, "hill") and worst["steer_oscillation_rad"] == (1.02, "lane_change")
    assert judged.violation == pytest.approx(1.02 / 0.05 - 1.0) and not judged.is_met
    assert violation_text(judged) == "steer_oscillation_rad 1.02 > 0.05 on lane_change (and 1 more requirement)"
    data = judged.as_data()
    assert data["requirements"]["lateral_error_peak_m"] == {"value": 0.6, "limit": 0.5, "road": "hill", "met": False}


def test_a_limit_is_kept_up_to_the_limit() -> None:
    assert judge_drives({"bend": drive(0.5, 0.05)}, LIMITS).is_met
    assert measure_violation({"bend": drive(0.5 * 1.001)}, LIMITS) == pytest.approx(0.001)


def test_each_re_plan_counts_once_where_none_is_allowed() -> None:
    assert [measure_violation({"bend": drive(replans=float(n))}, LIMITS) for n in (0, 1, 3)] == [0.0, 1.0, 3.0]


def test_a_drive_that_failed_is_beyond_every_other() -> None:
    failed = {"bend": drive(9.0), "hill": drive(outcome="left_lane")}
    judged = judge_drives(failed, LIMITS)
    assert judged.violation == CRITERIA.failed_violation and judged.failed == ("hill",)
    assert violation_text(judged).startswith("not driven to the end: hill; lateral_error_peak_m 9 > 0.5 on bend")
    assert measure_violation({"bend": drive(1e9)}, LIMITS) <= CRITERIA.failed_violation


def test_what_has_no_value_is_not_judged_and_said() -> None:
    judged = judge_drives({"bend": drive(None), "hill": drive(None, None)}, LIMITS)
    assert judged.is_met and judged.not_judged == {"lateral_error_peak_m": 2, "steer_oscillation_rad": 1}
    text = not_judged_text(judged)
    assert "lateral_error_peak_m" in text.partition(";")[0] and "steer_oscillation_rad on 1" in text
    old = judge_drives({"bend": {"score": 0.1, "outcome": "finished"}}, LIMITS)
    assert old.results == () and set(old.not_judged) == set(LIMITS)


def test_without_limits_nothing_is_judged() -> None:
    assert measure_violation({"bend": drive(9.0, outcome="left_lane")}, {}) == 0.0


@given(st.lists(st.floats(0.0, 100.0), min_size=1, max_size=5), st.floats(0.1, 10.0))
def test_a_further_road_never_lowers_the_violation(values: list[float], limit: float) -> None:
    drives = {f"road {i}": drive(value) for i, value in enumerate(values)}
    fewer = dict(list(drives.items())[:-1])
    limits = {"lateral_error_peak_m": limit}
    assert measure_violation(fewer, limits) <= measure_violation(drives, limits)
    assert (measure_violation(drives, limits) == 0.0) == all(value / limit <= 1.0 for value in values)


@pytest.mark.parametrize("name", ["steer_oscillation_rad", "pedal_alternation_per_s"])
def test_a_drive_oscillates_beyond_the_limits_that_count(name: str) -> None:
    default = requirement_limits(load_vehicle(ROOT / "dbc" / "mkz_bywire").limits, None)
    values = {name: 1.2 * default[name], "lateral_error_peak_m": 9.0}
    assert oscillates(values, default) and not oscillates(values, {**default, name: 1.3 * default[name]})
    assert not oscillates(values, {key: limit for key, limit in default.items() if key != name})  # switched off
    assert not oscillates({name: None, "lateral_error_peak_m": 9.0}, default)
