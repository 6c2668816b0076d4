"""What a drive is told: all of it is in the file, a wrong one is refused, and drives go on where they ended."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.collect.area import DrivingArea
from tunefree_hil.collect.bounds import bounds_from_valid_region
from tunefree_hil.collect.cells import CELL_COUNT
from tunefree_hil.collect.coverage import Coverage, coverage_map_lines
from tunefree_hil.collect.features import describe_missing_reports
from tunefree_hil.collect.plan import (
    FORWARDS_ONLY,
    DrivePlan,
    make_planner_params,
    plan_as_dict,
    plan_from_dict,
    plannable_cells,
    plannable_stretches,
)
from tunefree_hil.config.load import load_scenario, load_vehicle
from tunefree_hil.config.schema import ValidSpec
from tunefree_hil.episode.scenario import build_course, start_of
from tunefree_hil.jobs.collect.plan import StartPose, write_scenario
from tunefree_hil.jobs.collector import read_plan

PLAN = DrivePlan(10.0, 400.0, None, (1.5, -2.0), tuple(range(CELL_COUNT)), 14, 110.0)
MKZ = load_vehicle("mkz_bywire")
GENTLY = (MKZ, PLAN.quota_s, PLAN.stop_s, PLAN.area_m, PLAN.top_mps)


def test_a_plan_survives_its_file(tmp_path: Path) -> None:
    bounds = bounds_from_valid_region(MKZ, ValidSpec())
    for plan in (
        PLAN,
        PLAN._replace(centre=None, top_mps=12.0),
        PLAN._replace(stretches=(3, 6), bounds=bounds, coast_s=7.5),
    ):
        (tmp_path / "a.json").write_text(json.dumps(plan_as_dict(plan)))
        assert read_plan(tmp_path / "a.json") == plan


@pytest.mark.parametrize(
    "change",
    [{"have": [0, 1]}, {"schema": "other"}, {"stretches": 3}, {"area_m": "wide"}, {"centre": [1.0]}, {"bounds": [1.0]}],
)
def test_a_wrong_plan_is_refused_by_name(change: dict[str, object]) -> None:
    with pytest.raises(InputError, match=r"a\.json: is not a plan"):
        plan_from_dict({**plan_as_dict(PLAN), **change}, "a.json")


def test_a_missing_plan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read the plan of a drive"):
        read_plan(tmp_path / "none.json")


def test_params_are_the_plan_in_ticks_and_places() -> None:
    params = make_planner_params(MKZ, PLAN, 0.01)
    assert (params.stop_tick, params.first_hold, params.have, params.stretches) == (11000, 14, PLAN.have, ())
    assert (
        make_planner_params(MKZ, PLAN._replace(stretches=(3, 6)), 0.01).stretches == plannable_stretches(*GENTLY)[3:6]
    )
    longer = make_planner_params(MKZ, PLAN._replace(stretches=(3, 6), coast_s=9.0), 0.01).stretches
    assert {one.coast_s for one in longer} == {9.0}
    assert params.area == DrivingArea(1.5, -2.0, 200.0)
    assert {need for need, target in zip(params.need, params.targets, strict=True) if not target.excluded} == {1000}
    assert all(need == 0 for need, target in zip(params.need, params.targets, strict=True) if target.excluded)


def test_backwards_is_left_to_a_person_where_the_vehicle_can() -> None:
    fields = {name: getattr(MKZ.limits, name) for name in MKZ.limits.__struct_fields__}
    limits = type(MKZ.limits)(**{**fields, "reverse_mps": 2.0})
    whole = {name: getattr(MKZ, name) for name in MKZ.__struct_fields__}
    targets = plannable_cells(type(MKZ)(**{**whole, "limits": limits}), None)
    assert {one.excluded for one in targets if one.index.backwards} == {FORWARDS_ONLY}


def test_the_car_stands_where_the_last_drive_ended(tmp_path: Path) -> None:
    write_scenario(tmp_path / "drive-002.toml", 2, StartPose(31.25, -7.5, 2.75), 5, 110.0)
    spec = load_scenario(tmp_path / "drive-002.toml")
    course = build_course(spec, 0.01)
    start = start_of(spec, course)
    assert (start.x_m, start.y_m, start.speed_mps) == (31.25, -7.5, 0.0)
    assert math.isclose(start.heading_rad, 2.75) and spec.noise_seed == 7
    assert course.ticks * 0.01 > 150.0


def test_the_map_fits_a_terminal_and_shows_what_was_had() -> None:
    coverage = Coverage(MKZ, plannable_cells(MKZ, None), 10.0, 0.01)
    coverage.counter.have[0], coverage.counter.have[6] = 430, 40
    lines = coverage_map_lines(coverage)
    assert max(map(len, lines)) <= 80 and len(lines) == 2 + 3 * 7
    assert any("4.3/10" in line for line in lines) and any("(0.4)" in line for line in lines)
    data = coverage.as_dict()
    assert data["cells"][0]["have_s"] == 4.3 and data["cells_wanted"] == 78 and data["cells_full"] == 0


def test_without_a_speed_there_is_nothing_to_hold_and_that_is_said() -> None:
    whole = {name: getattr(MKZ, name) for name in MKZ.__struct_fields__}
    for group in ("report", "ins"):
        whole[group] = {name: one for name, one in whole[group].items() if name != "speed_mps"}
    blind = type(MKZ)(**whole)
    assert plannable_stretches(blind, *GENTLY[1:]) == () != plannable_stretches(*GENTLY)
    assert any("gentle" in line for line in describe_missing_reports(blind))


def test_what_a_missing_report_costs_is_said() -> None:
    assert describe_missing_reports(MKZ) == []
    words = describe_missing_reports(load_vehicle("rav4_2017", check=False))
    assert any("brake_frac" in line for line in words) and all("no [report." in line for line in words)
