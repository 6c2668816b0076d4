"""Every family, on every vehicle and at any speed, gives roads that the vehicle can drive within the road limits."""

from __future__ import annotations

import math
from itertools import pairwise
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import other_vehicle
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.episode.feasible import check_feasible, curvature_by_time, limits_of
from tunefree_hil.episode.scenario import build_course, integrate
from tunefree_hil.roads.draft import STEP_S, RoadRequest
from tunefree_hil.roads.families import FAMILIES, RoadFamily
from tunefree_hil.roads.families.evasions import build_evasion
from tunefree_hil.roads.families.hills import build_hills
from tunefree_hil.roads.families.lane_changes import build_double_lane_change
from tunefree_hil.roads.families.ramps import build_off_ramp, build_on_ramp
from tunefree_hil.roads.families.roundabouts import RADIUS_M
from tunefree_hil.roads.generation import RoadLabel, make_road
from tunefree_hil.roads.limits import CRITERIA, RoadLimits, road_limits

VEHICLES = {path: load_vehicle(path) for path in (other_vehicle.FIRST, str(other_vehicle.FOLDER))}
LIMITS = {path: road_limits(vehicle) for path, vehicle in VEHICLES.items()}
MKZ = LIMITS[other_vehicle.FIRST]
BY_NAME = {family.name: family for family in FAMILIES}
DT_S = 0.01
LARGEST_JERK = 5.0  # ISO 11270, ISO 15622
SPEEDS = st.floats(0.0, 1.0)


def road(family: RoadFamily, request: RoadRequest, limits: RoadLimits, seed: int = 1, offsets: bool = True):
    return make_road(family, request, limits, RoadLabel("s1", seed, f"test {seed}"), offsets)


def heading_rad(spec: ScenarioSpec) -> float:
    """Change of heading from the first to the last moment."""
    return float(integrate(spec).heading_rad[-1])


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
@settings(max_examples=20, deadline=None)
@given(
    vehicle=st.sampled_from(sorted(VEHICLES)),
    speed=SPEEDS,
    lateral=st.floats(0.2, 1.0),
    longitudinal=st.floats(0.2, 1.0),
    left=st.booleans(),
    seed=st.integers(0, 10_000),
)
def test_a_road_can_be_driven(
    family: RoadFamily, vehicle: str, speed: float, lateral: float, longitudinal: float, left: bool, seed: int
) -> None:
    limits = LIMITS[vehicle]
    high = min(family.high_mps, limits.speed_mps)
    request = RoadRequest(
        family.low_mps + speed * (high - family.low_mps), lateral * limits.lateral_accel_mps2, longitudinal, left
    )
    spec = road(family, request, limits, seed)
    course = build_course(spec, DT_S)
    assert check_feasible(course, limits_of(VEHICLES[vehicle])) == []
    assert CRITERIA.min_duration_s - 1e-9 <= spec.speed.t_s[-1] <= CRITERIA.max_duration_s + 1e-9
    assert abs(spec.start.lateral_m) <= 0.2 and abs(spec.start.speed_mps - spec.speed.value[0]) <= 0.2 + 1e-3
    assert_comfortable(spec, limits)


def assert_comfortable(spec: ScenarioSpec, limits: RoadLimits) -> None:
    """Lateral and longitudinal acceleration and jerk, from the course alone."""
    course = build_course(spec, DT_S)
    speed, accel = np.asarray(course.speed_mps), np.asarray(course.accel_mps2)
    lateral = speed * speed * curvature_by_time(course)
    window = round(0.5 / DT_S)
    assert np.max(np.abs(lateral)) <= min(3.0, limits.lateral_accel_mps2) * 1.01
    assert np.max(np.abs(lateral[window:] - lateral[:-window])) / 0.5 <= LARGEST_JERK * 1.02
    assert np.max(np.abs(accel[window:] - accel[:-window])) / 0.5 <= LARGEST_JERK * 1.02
    fast = speed >= 20.0
    if fast.any():
        assert accel[fast].min() >= -3.5 * 1.01 and accel[fast].max() <= 2.0 * 1.01


def test_a_manoeuvre_is_driven_at_the_requested_speed() -> None:
    for family in FAMILIES:
        speed = min(0.5 * (family.low_mps + family.high_mps), MKZ.speed_mps)
        spec = road(family, RoadRequest(speed, 1.5, 0.8), MKZ)
        assert any(abs(value - speed) < 0.01 for value in spec.speed.value), family.name


def test_a_bend_asks_for_the_requested_lateral_acceleration() -> None:
    for name in ("turn", "steady_circle", "off_ramp", "on_ramp", "hills"):
        spec = road(BY_NAME[name], RoadRequest(16.0, 2.2, 0.8), MKZ)
        course = build_course(spec, DT_S)
        lateral = np.square(course.speed_mps) * curvature_by_time(course)
        assert np.max(np.abs(lateral)) == pytest.approx(2.2, rel=0.03), name


def test_the_side_is_that_of_the_request() -> None:
    for family in FAMILIES:
        speed = min(0.5 * (family.low_mps + family.high_mps), 20.0)
        left, right = (road(family, RoadRequest(speed, 1.5, 0.8, is_left), MKZ) for is_left in (True, False))
        assert np.asarray(left.curvature.value) == pytest.approx(-np.asarray(right.curvature.value)), family.name


@pytest.mark.parametrize("seed", range(5))
def test_a_u_turn_turns_back_and_a_lane_change_does_not_turn(seed: int) -> None:
    turned = heading_rad(road(BY_NAME["u_turn"], RoadRequest(4.0, 2.0, 0.8), MKZ, seed))
    assert turned == pytest.approx(math.pi, abs=0.05)
    for name in ("lane_change", "double_lane_change", "evasion", "slalom", "weave"):
        assert abs(heading_rad(road(BY_NAME[name], RoadRequest(16.0, 2.0, 0.8), MKZ, seed))) < 0.01, name


def test_a_double_lane_change_shifts_by_three_and_a_half_metres_and_comes_back() -> None:
    course = build_course(road(BY_NAME["double_lane_change"], RoadRequest(20.0, 3.0, 0.5), MKZ), DT_S)
    y = np.asarray(course.path_y_m)
    assert y.max() == pytest.approx(3.5, abs=0.1)
    assert abs(y[-1]) < 0.1
    assert np.min(y) > -0.1


def test_an_evasion_brakes_while_it_moves_to_the_side() -> None:
    draft = build_evasion(RoadRequest(20.0, 2.5, 1.0), MKZ, Random(1))
    back = int(np.argmin(draft.curvature_1pm[:50]))  # the second half of the first move
    assert (draft.speed_mps[back + 1] - draft.speed_mps[back - 1]) / (2.0 * STEP_S) < -2.0
    assert draft.speed_mps.min() < 16.0


def test_an_off_ramp_tightens_while_braking_and_an_on_ramp_opens_while_accelerating() -> None:
    request = RoadRequest(26.0, 2.0, 0.8)
    off, on = (build(request, MKZ, Random(1)) for build in (build_off_ramp, build_on_ramp))
    braking = np.flatnonzero(np.diff(off.speed_mps) < -0.05)
    faster = np.flatnonzero(np.diff(on.speed_mps) > 0.02)
    assert np.all(np.diff(off.curvature_1pm[braking[15:]]) >= 0.0)
    assert np.all(np.diff(on.curvature_1pm[faster[:-15]]) <= 0.0)
    assert off.curvature_1pm.max() > 2.0 * off.curvature_1pm[braking[0] + 8]


def test_a_roundabout_has_a_usual_radius_and_deflects_at_both_ends() -> None:
    for seed in range(20):
        spec = road(BY_NAME["roundabout"], RoadRequest(4.0 + 0.27 * seed, 1.0 + 0.1 * seed, 0.7), MKZ, seed)
        curvature = np.asarray(spec.curvature.value)
        assert RADIUS_M[0] * 0.99 <= 1.0 / curvature.max() <= RADIUS_M[1] * 1.01
        signs = np.sign(curvature[np.abs(curvature) > 0.3 * curvature.max()])
        assert np.count_nonzero(np.diff(signs)) == 2 and signs[0] < 0.0


def test_hills_have_slopes_of_both_signs_that_leave_power_for_the_speed() -> None:
    for speed in (6.0, 14.0, 29.0):
        draft = build_hills(RoadRequest(speed, 1.5, 1.0), MKZ, Random(3))
        assert draft.grade_rad is not None
        assert draft.grade_rad.max() > 0.015 and draft.grade_rad.min() < -0.015
        vertical = draft.speed_mps[1:] * np.diff(draft.grade_rad) / STEP_S
        assert np.max(np.abs(vertical)) <= 0.5 * 1.2


def test_fast_hills_are_driven_at_their_speed() -> None:
    """Their crests are long at speed; slopes get gentler, the road does not get slower."""
    strong = MKZ._replace(accel_mps2=3.0)
    for seed in range(20):
        speeds = road(BY_NAME["hills"], RoadRequest(29.0, 1.5, 0.6), strong, seed).speed.value
        assert any(abs(value - 29.0) < 0.01 for value in speeds)


def test_a_straight_road_has_wet_patches_and_a_stop_ends_at_standstill() -> None:
    wet = road(BY_NAME["straight"], RoadRequest(25.0, 2.0, 0.7), MKZ)
    assert wet.friction is not None and 0.55 <= min(wet.friction.value) <= 0.9
    assert max(wet.friction.value) == 1.0 and max(np.abs(wet.curvature.value)) == 0.0
    assert min(road(BY_NAME["full_stop"], RoadRequest(28.0, 2.0, 0.7), MKZ).speed.value) == 0.0
    stops = road(BY_NAME["stop_and_go"], RoadRequest(5.0, 2.0, 0.9), MKZ).speed.value
    assert stops[-1] == 0.0 and sum(low == 0.0 < high for low, high in pairwise(stops)) >= 2


@pytest.mark.parametrize("vehicle", sorted(VEHICLES))
def test_a_straight_road_has_a_bank_and_one_or_two_gusts(vehicle: str) -> None:
    limits, counts, sides = LIMITS[vehicle], set[int](), set[float]()
    for seed in range(30):
        spec = road(BY_NAME["straight"], RoadRequest(min(20.0, limits.speed_mps), 2.0, 0.7), limits, seed)
        course = build_course(spec, DT_S)
        bank, wind = np.asarray(course.bank_rad), np.asarray(course.side_wind_mps2)
        assert 0.02 <= np.max(np.abs(bank)) <= 0.06 and bank[0] == bank[-1] == 0.0
        assert 0.2 <= np.max(np.abs(wind)) <= 0.8 and wind[0] == wind[-1] == 0.0
        blowing = np.flatnonzero(np.diff(np.abs(wind) > 0.01))
        lasting_s = DT_S * (blowing[1::2] - blowing[::2])
        assert np.all((lasting_s > 0.7) & (lasting_s <= 2.0)), "1 to 2 s, less the ends of the cosine"
        counts.add(len(lasting_s))
        sides.add(float(np.sign(wind.sum())))
        assert check_feasible(course, limits_of(VEHICLES[vehicle])) == []
    assert counts == {1, 2} and sides == {-1.0, 1.0}


def test_bank_and_gusts_are_smaller_where_there_is_little_grip() -> None:
    for lateral_mps2 in (1.0, 0.3):
        spec = road(BY_NAME["straight"], RoadRequest(20.0, 1.0, 0.7), MKZ._replace(lateral_accel_mps2=lateral_mps2))
        assert spec.bank is not None and spec.side_wind is not None
        pull = 9.81 * max(np.abs(spec.bank.value)) + max(np.abs(spec.side_wind.value))
        assert 0.2 * lateral_mps2 < pull <= lateral_mps2


def test_no_other_family_has_bank_or_wind() -> None:
    for family in FAMILIES:
        spec = road(family, RoadRequest(min(0.5 * (family.low_mps + family.high_mps), 20.0), 1.5, 0.8), MKZ)
        assert (spec.bank is None and spec.side_wind is None) == (family.name != "straight"), family.name


def test_a_lane_change_takes_longer_where_the_jerk_is_bounded() -> None:
    """At 3 m/s2 the shift of 3.5 m would take 2.7 s; a jerk of 4.5 m/s3 needs 3.1 s."""
    draft = build_double_lane_change(RoadRequest(20.0, 3.0, 0.5), MKZ, Random(1))
    lateral = np.square(draft.speed_mps) * draft.curvature_1pm
    assert np.max(np.abs(np.diff(lateral))) / STEP_S == pytest.approx(4.5, rel=0.05)
    assert lateral.max() < 2.5
