"""The reference follower: zero on the path, signs, previews, re-plans, invariance."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.control.fixes import AHEAD_M, DT_S, fix, run, straight
from tunefree_hil.base.records import Ins
from tunefree_hil.control.follower import make_follower


def follow_circle(curvature, speed, ticks, lateral=0.0):
    """Fixes of a vehicle whose centre of mass is on a circle and whose heading is the tangent there."""
    radius = 1.0 / curvature
    for k in range(ticks):
        angle = (speed * k * DT_S + AHEAD_M) * curvature
        x = (radius - lateral) * math.sin(angle) - AHEAD_M * math.cos(angle)
        y = radius - (radius - lateral) * math.cos(angle) - AHEAD_M * math.sin(angle)
        yield Ins(x, y, angle, speed, 0.0, speed * curvature)


def test_no_error_on_the_path(kit):
    answers = run(make_follower(straight(kit), AHEAD_M), [fix(x=0.05 * k) for k in range(1500)])
    for k, tracking in enumerate(answers):
        errors = (
            tracking.station_error_m,
            tracking.speed_error_mps,
            tracking.lateral_error_m,
            tracking.lateral_error_rate_mps,
            tracking.heading_error_rad,
            tracking.heading_error_rate_radps,
        )
        assert max(abs(error) for error in errors) < 1e-9
        assert tracking.replan == 0.0
        assert tracking.ref_x_m == pytest.approx(0.05 * k + AHEAD_M)


def test_errors_are_at_the_centre_of_mass(kit):
    course = kit.course(10.0, lambda t: 5.0, lambda station: 0.05)
    for tracking in run(make_follower(course, AHEAD_M), follow_circle(0.05, 5.0, 800))[10:]:
        assert abs(tracking.lateral_error_m) < 1e-6
        assert abs(tracking.heading_error_rad) < 1e-6
        assert abs(tracking.heading_error_rate_radps) < 1e-9
        assert tracking.ref_curvature_1pm == pytest.approx(0.05)
        # The rear axle runs on a wider circle, and its foot is atan(l/R) behind.
        wider = 1.0 / math.sqrt(1.0 + (0.05 * AHEAD_M) ** 2)
        assert tracking.speed_error_mps == pytest.approx(5.0 - 5.0 * wider * wider, abs=1e-5)
        assert tracking.station_error_m == pytest.approx(math.atan(0.05 * AHEAD_M) / 0.05 - AHEAD_M, abs=1e-5)


def test_signs(kit):
    course = straight(kit)
    left = run(make_follower(course, AHEAD_M), [fix(y=0.2)])[0]
    assert left.lateral_error_m == pytest.approx(0.2)
    turned = run(make_follower(course, AHEAD_M), [fix(heading=0.1)])[0]
    assert turned.heading_error_rad == pytest.approx(0.1)
    assert turned.lateral_error_m == pytest.approx(AHEAD_M * math.sin(0.1))
    assert turned.lateral_error_rate_mps == pytest.approx(5.0 * math.sin(0.1))
    assert turned.speed_error_mps == pytest.approx(5.0 - 5.0 * math.cos(0.1))
    turning = run(make_follower(course, AHEAD_M), [fix(yaw_rate=0.3)])[0]
    assert turning.heading_error_rate_radps == pytest.approx(0.3)
    behind = run(make_follower(course, AHEAD_M), [fix(x=-1.0, speed=4.0)])[0]
    assert behind.station_error_m == pytest.approx(1.0)
    assert behind.speed_error_mps == pytest.approx(1.0)
    assert (left.ref_x_m, left.ref_y_m) == (pytest.approx(AHEAD_M), pytest.approx(0.0))


def test_heading_error_is_wrapped(kit):
    tracking = run(make_follower(straight(kit), AHEAD_M), [fix(heading=0.1 + 4.0 * math.pi)])[0]
    assert tracking.heading_error_rad == pytest.approx(0.1)


def test_previews(kit):
    course = kit.course(10.0, lambda t: 5.0 if t < 5.0 else 5.0 - (t - 5.0))
    answers = run(make_follower(course, AHEAD_M), [fix(x=0.05 * k) for k in range(500)])
    assert answers[490].preview_speed_mps == pytest.approx(4.9)
    assert answers[490].preview_accel_mps2 == pytest.approx(-1.0)
    assert answers[490].ref_accel_mps2 == pytest.approx(0.0, abs=1e-9)
    assert answers[490].ref_speed_mps == pytest.approx(5.0)


def test_look_ahead_sees_the_bend(kit):
    course = kit.course(10.0, lambda t: 5.0, lambda station: 0.05)
    block = make_follower(course, AHEAD_M, look_ahead_m=2.0)
    tracking = run(block, follow_circle(0.05, 5.0, 300))[-1]
    assert tracking.preview_heading_change_rad == pytest.approx(2.0 * 0.05, abs=1e-4)
    assert tracking.preview_curvature_1pm == pytest.approx(0.05)
    none = run(make_follower(course, AHEAD_M), follow_circle(0.05, 5.0, 300))[-1]
    assert (none.preview_heading_change_rad, none.preview_curvature_1pm) == (0.0, none.ref_curvature_1pm)


def test_stop_and_go(kit):
    def speed(t):
        return 2.0 if t < 4.0 else max(0.0, 6.0 - t) if t < 9.0 else min(2.0, t - 9.0)

    course = kit.course(15.0, speed)
    answers = run(make_follower(course, AHEAD_M), [fix(x=x, speed=v) for x, v in zip(
        course.station_m, course.speed_mps, strict=True)])  # fmt: skip
    assert answers[0].path_remaining_m == pytest.approx(10.0)
    assert answers[500].path_remaining_m == pytest.approx(0.5)
    assert answers[750].path_remaining_m == pytest.approx(0.0, abs=1e-9)
    assert answers[905].path_remaining_m > 20.0
    assert max(abs(tracking.station_error_m) for tracking in answers) < 1e-9
    assert max(abs(tracking.speed_error_mps) for tracking in answers) < 1e-9


def test_u_turn_keeps_its_branch(kit):
    # 15 m out, half a circle of 7 m (radius 2.2 m), back 4.4 m beside the way out; the vehicle 0.4 m to its inner side.
    turn_m, inner = 7.0, 0.4
    radius = turn_m / math.pi
    course = kit.course(19.0, lambda t: 2.0, lambda s: 1.0 / radius if 15.0 <= s < 15.0 + turn_m else 0.0)
    block = make_follower(course, 0.0)

    def fixes():
        for k in range(1850):
            s = 2.0 * k * DT_S
            if s < 15.0:
                yield fix(s, inner, 0.0, 2.0)
            elif s < 15.0 + turn_m:
                angle = (s - 15.0) / radius
                reach = radius - inner
                yield fix(15.0 + reach * math.sin(angle), radius - reach * math.cos(angle), angle, 2.0)
            else:
                yield fix(15.0 - (s - 15.0 - turn_m), 2.0 * radius - inner, math.pi, 2.0)

    answers = run(block, fixes())
    assert max(abs(tracking.lateral_error_m - inner) for tracking in answers) < 0.002
    assert max(abs(tracking.station_error_m) for tracking in answers) < 0.1
    assert max(abs(tracking.heading_error_rad) for tracking in answers) < 0.05
    assert not any(tracking.replan for tracking in answers)


def test_numbers_that_are_not_finite_say_so_and_change_nothing(kit):
    block = make_follower(straight(kit), AHEAD_M)
    state = block.init(block.params, DT_S)
    for bad in (math.nan, math.inf, -math.inf):
        after, tracking = block.step(block.params, state, (0, fix(x=bad)), DT_S)
        assert math.isnan(tracking.lateral_error_m)
        assert tracking.replan == 0.0
        assert after == state


@settings(max_examples=25, deadline=None)
@given(
    st.floats(-300.0, 300.0),
    st.floats(-300.0, 300.0),
    st.floats(-3.0, 3.0),
    st.floats(-0.7, 0.7),
    st.floats(-0.2, 0.2),
    st.floats(0.0, 9.0),
)
def test_errors_do_not_change_with_the_place_on_the_map(kit, x, y, turn, lateral, heading, speed):
    def moved(ins):
        cos, sin = math.cos(turn), math.sin(turn)
        return ins._replace(
            x_m=x + cos * ins.x_m - sin * ins.y_m, y_m=y + sin * ins.x_m + cos * ins.y_m,
            heading_rad=ins.heading_rad + turn,
        )  # fmt: skip

    fixes = [fix(0.05 * k, lateral, heading, speed) for k in range(120)]
    answers = []
    for pose, path in (((0.0, 0.0, 0.0), fixes), ((x, y, turn), [moved(ins) for ins in fixes])):
        course = kit.course(3.0, lambda t: 5.0, lambda station: 0.04 * math.sin(station), pose)
        answers.append(run(make_follower(course, AHEAD_M, 1.0), path))
    for one, other in zip(*answers, strict=True):
        assert one.replan == other.replan
        for name in ("station_error_m", "speed_error_mps", "lateral_error_m", "heading_error_rad", "ref_curvature_1pm"):
            assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-8)
