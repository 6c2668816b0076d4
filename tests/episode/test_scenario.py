"""Breakpoints -> Course: exact where it can be, consistent everywhere."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec, StartSpec
from tunefree_hil.episode.scenario import PROLONGED_M, build_course, integrate, start_of

DT_S = 0.01


def profile(*points: tuple[float, float]) -> ProfileSpec:
    return ProfileSpec(t_s=[t for t, _ in points], value=[value for _, value in points])


def scenario(speed: ProfileSpec, curvature: ProfileSpec | None = None, **more: Any) -> ScenarioSpec:
    bend = curvature or profile((0.0, 0.0), (1.0, 0.0))
    return ScenarioSpec(
        schema="tunefree.scenario/1", name="test", speed=speed, curvature=bend, path="test.toml", **more
    )


def stations(course: Course) -> np.ndarray:
    return course.first_station_m + np.arange(len(course.path_x_m)) * course.spacing_m


def at_station(course: Course, values: object, station_m: float) -> float:
    return float(np.interp(station_m, stations(course), np.asarray(values)))


@st.composite
def drives(draw: st.DrawFn) -> ScenarioSpec:
    """Random drives with standstills; curvature up to a tight corner."""
    times = np.cumsum([0.0, *draw(st.lists(st.floats(0.3, 3.0), min_size=2, max_size=6))]).tolist()
    speeds = draw(st.lists(st.sampled_from([0.0, 0.0, 2.0, 5.0, 11.0]), min_size=len(times), max_size=len(times)))
    bends = draw(st.lists(st.floats(-0.15, 0.15), min_size=len(times), max_size=len(times)))
    shifted = [0.0, *(0.9 * t for t in times[1:])]
    return scenario(ProfileSpec(t_s=times, value=speeds), ProfileSpec(t_s=shifted, value=bends))


def test_straight_at_constant_speed() -> None:
    course = build_course(scenario(profile((0.0, 5.0), (10.0, 5.0))), DT_S)
    assert course.ticks == 1000
    assert len(course.station_m) == len(course.speed_mps) == len(course.accel_mps2) == 1001
    np.testing.assert_allclose(course.station_m, np.arange(1001) * 0.05, atol=1e-12)
    np.testing.assert_allclose(course.path_x_m, stations(course), atol=1e-12)
    assert set(course.path_y_m) == set(course.path_heading_rad) == set(course.path_curvature_1pm) == {0.0}
    assert set(course.grade_rad) == {0.0}
    assert set(course.friction_frac) == {1.0}
    assert set(course.bank_rad) == set(course.side_wind_mps2) == {0.0}
    assert type(course.path_x_m[0]) is float
    assert type(course.speed_mps[0]) is float


def test_circle_is_a_circle() -> None:
    course = build_course(scenario(profile((0.0, 4.0), (15.0, 4.0)), profile((0.0, 0.1), (15.0, 0.1))), DT_S)
    on_it = (stations(course) >= 0.0) & (stations(course) <= 60.0)
    radius = np.hypot(np.asarray(course.path_x_m)[on_it], np.asarray(course.path_y_m)[on_it] - 10.0)
    np.testing.assert_allclose(radius, 10.0, atol=1e-7)
    assert at_station(course, course.path_heading_rad, 60.0) == pytest.approx(6.0)


def test_speed_ramp_by_hand() -> None:
    """2 m/s2 from rest for 2 s: 4 m; then 1 s at 4 m/s: 8 m. A row's slope is that of the piece beginning there."""
    course = build_course(scenario(profile((0.0, 0.0), (2.0, 4.0), (3.0, 4.0))), DT_S)
    assert course.station_m[100] == pytest.approx(1.0)
    assert course.station_m[200] == pytest.approx(4.0)
    assert course.station_m[300] == pytest.approx(8.0)
    assert course.accel_mps2[199] == pytest.approx(2.0)
    assert course.accel_mps2[200] == course.accel_mps2[300] == 0.0


def test_curvature_and_speed_that_change_together() -> None:
    """Against a brute-force integration in 10 microsecond steps."""
    spec = scenario(profile((0.0, 2.0), (4.0, 8.0)), profile((0.0, 0.0), (1.0, 0.1), (3.0, -0.05), (4.0, 0.0)))
    course = build_course(spec, DT_S)
    time = (np.arange(400_000) + 0.5) * 1e-5
    speed = np.interp(time, spec.speed.t_s, spec.speed.value)
    turn = speed * np.interp(time, spec.curvature.t_s, spec.curvature.value) * 1e-5
    heading = np.cumsum(turn) - 0.5 * turn
    end = course.station_m[-1]
    assert end == pytest.approx(20.0)
    assert at_station(course, course.path_heading_rad, end) == pytest.approx(float(np.sum(turn)), abs=1e-6)
    x_m, y_m = float(np.sum(speed * np.cos(heading)) * 1e-5), float(np.sum(speed * np.sin(heading)) * 1e-5)
    assert at_station(course, course.path_x_m, end) == pytest.approx(x_m, abs=1e-5)
    assert at_station(course, course.path_y_m, end) == pytest.approx(y_m, abs=1e-5)


@given(drives())
@settings(max_examples=25, deadline=None)
def test_time_and_path_agree(spec: ScenarioSpec) -> None:
    course = build_course(spec, DT_S)
    assert 0.0 <= spec.speed.t_s[-1] - course.ticks * DT_S < DT_S + 1e-9
    station = np.asarray(course.station_m)
    assert (np.diff(station) >= 0.0).all()
    np.testing.assert_allclose(
        np.diff(station), DT_S * 0.5 * (np.asarray(course.speed_mps[:-1]) + course.speed_mps[1:]), atol=1e-3
    )
    x, y, heading, bend = (
        np.asarray(values)
        for values in (course.path_x_m, course.path_y_m, course.path_heading_rad, course.path_curvature_1pm)
    )
    chord = np.hypot(np.diff(x), np.diff(y))
    assert (chord <= course.spacing_m + 1e-9).all()
    assert (chord >= course.spacing_m - 1e-5).all()
    middle = 0.5 * (heading[:-1] + heading[1:])
    np.testing.assert_allclose(np.diff(x), course.spacing_m * np.cos(middle), atol=2e-3)
    np.testing.assert_allclose(np.diff(y), course.spacing_m * np.sin(middle), atol=2e-3)
    assert np.abs(bend).max() <= max(np.abs(spec.curvature.value)) + 1e-12
    assert np.abs(np.diff(heading)).max() <= max(np.abs(spec.curvature.value)) * course.spacing_m + 1e-9


@given(drives())
@settings(max_examples=15, deadline=None)
def test_ends_go_straight_on(spec: ScenarioSpec) -> None:
    course = build_course(spec, DT_S)
    where, heading = stations(course), np.asarray(course.path_heading_rad)
    assert where[0] == -PROLONGED_M
    assert where[-1] >= course.station_m[-1] + PROLONGED_M - 1e-9
    assert set(heading[where <= 0.0]) == {0.0}
    after = where > integrate(spec).station_m[-1] + 1e-9
    np.testing.assert_allclose(heading[after], heading[-1], atol=1e-12)
    assert set(np.asarray(course.path_curvature_1pm)[after]) == {0.0}


def test_standstill_takes_no_room() -> None:
    """A stop of 3 s leaves the path as it would be without it."""
    stop = scenario(
        profile((0.0, 4.0), (2.0, 0.0), (5.0, 0.0), (7.0, 4.0)),
        profile((0.0, 0.0), (2.0, 0.05), (5.0, 0.05), (7.0, 0.0)),
    )
    none = scenario(profile((0.0, 4.0), (2.0, 0.0), (4.0, 4.0)), profile((0.0, 0.0), (2.0, 0.05), (4.0, 0.0)))
    one, other = build_course(stop, DT_S), build_course(none, DT_S)
    assert set(one.station_m[200:501]) == {one.station_m[200]}
    np.testing.assert_allclose(one.path_x_m, other.path_x_m, atol=1e-9)
    np.testing.assert_allclose(one.path_y_m, other.path_y_m, atol=1e-9)


def test_only_standstill() -> None:
    course = build_course(scenario(profile((0.0, 0.0), (2.0, 0.0)), profile((0.0, 0.1), (2.0, 0.1))), DT_S)
    assert set(course.station_m) == {0.0}
    assert set(course.path_curvature_1pm) == {0.0}
    assert len(course.path_x_m) == 401


def test_start_is_left_of_the_path() -> None:
    spec = scenario(profile((0.0, 3.0), (5.0, 3.0)), start=StartSpec(lateral_m=0.2, heading_rad=0.05, speed_mps=3.0))
    start = start_of(spec, build_course(spec, DT_S))
    assert start == pytest.approx((0.0, 0.2, 0.05, 3.0))


def test_road_is_sampled() -> None:
    road = {"grade": profile((0.0, 0.0), (5.0, 0.1)), "friction": profile((0.0, 0.4), (5.0, 0.4))}
    course = build_course(scenario(profile((0.0, 3.0), (10.0, 3.0)), **road), DT_S)
    assert course.grade_rad[250] == pytest.approx(0.05)
    assert course.grade_rad[1000] == pytest.approx(0.1)
    assert set(course.friction_frac) == {0.4}


def test_bank_and_side_wind_are_sampled_and_checked_like_the_rest() -> None:
    road = {"bank": profile((0.0, 0.0), (5.0, 0.1)), "side_wind": profile((0.0, -0.4), (10.0, 0.6))}
    course = build_course(scenario(profile((0.0, 3.0), (10.0, 3.0)), **road), DT_S)
    assert course.road_at(250) == pytest.approx((0.0, 1.0, 0.05, -0.15))
    assert course.road_at(1000) == pytest.approx((0.0, 1.0, 0.1, 0.6))
    for key in road:
        with pytest.raises(InputError) as caught:
            build_course(
                scenario(profile((0.0, 3.0), (10.0, 3.0)), **{key: profile((0.0, math.nan), (1.0, 0.0))}), DT_S
            )
        assert (caught.value.code, caught.value.key) == ("bad_profile", key)


def test_two_builds_are_the_same_bits() -> None:
    spec = scenario(profile((0.0, 3.0), (9.0, 6.0)), profile((0.0, 0.0), (4.0, 0.07), (9.0, 0.0)))
    assert build_course(spec, DT_S) == build_course(spec, DT_S)


@pytest.mark.parametrize(
    ("speed", "key", "words"),
    [
        (profile((0.0, 1.0)), "speed", "two at least"),
        (ProfileSpec(t_s=[0.0, 1.0], value=[1.0]), "speed", "as many"),
        (profile((0.5, 1.0), (1.0, 1.0)), "speed", "begin at 0"),
        (profile((0.0, 1.0), (1.0, 1.0), (1.0, 2.0)), "speed", "entry 2 (1.0)"),
        (profile((0.0, math.nan), (1.0, 1.0)), "speed", "finite"),
        (profile((0.0, 1.0), (1.0, -0.1)), "speed.value", "negative"),
        (profile((0.0, 1.0), (0.001, 1.0)), "speed.t_s", "less than one tick"),
    ],
)
def test_bad_profiles_are_refused(speed: ProfileSpec, key: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        build_course(scenario(speed), DT_S)
    assert caught.value.file == "test.toml"
    assert caught.value.key == key
    assert words in caught.value.message
