"""Re-plans of the reference follower (docs/reference/grading.md): when, anchored where, blended how."""

from __future__ import annotations

import itertools
import math

import pytest

from tests.control.fixes import AHEAD_M, DT_S, fix, run, straight
from tunefree_hil.control.follower import ReplanRules, make_follower


@pytest.mark.parametrize("shift", [{"y": 0.51}, {"x": -2.51}, {"x": 2.51}])
def test_replan_at_the_thresholds(kit, shift):
    inside = {key: value - math.copysign(0.02, value) for key, value in shift.items()}
    assert run(make_follower(straight(kit), AHEAD_M), [fix(**inside)])[0].replan == 0.0
    assert run(make_follower(straight(kit), AHEAD_M), [fix(**shift)])[0].replan == 1.0


def test_replan_anchors_pose_speed_and_time_at_the_measured_state(kit):
    # 0.6 m to the left, 1 m behind, 1 m/s too slow, turned by 0.05 rad: from the next tick on none of it is an error.
    def at(k):
        along = 4.0 * k * DT_S
        return fix(
            x=49.0 - AHEAD_M + along * math.cos(0.05), y=0.6 - AHEAD_M * math.sin(0.05) + along * math.sin(0.05),
            heading=0.05, speed=4.0,
        )  # fmt: skip

    fixes = [fix(x=0.05 * k) for k in range(1000)] + [at(k) for k in range(3)]
    answers = run(make_follower(straight(kit), AHEAD_M), fixes)
    event, after = answers[1000], answers[1001]
    assert event.replan == 1.0
    assert event.lateral_error_m == pytest.approx(0.6)  # says why
    assert after.replan == 0.0
    assert after.lateral_error_m == pytest.approx(0.0, abs=1e-4)
    assert after.heading_error_rad == pytest.approx(0.0, abs=1e-4)
    assert after.station_error_m == pytest.approx(0.0, abs=1e-3)
    assert after.speed_error_mps == pytest.approx(0.0, abs=1e-2)
    assert after.path_lateral_error_m == pytest.approx(0.6 + 0.04 * math.sin(0.05))
    assert after.path_heading_error_rad == pytest.approx(0.05)


def test_after_a_replan_it_blends_back_over_3_s_and_does_not_catch_up(kit):
    def fixes():
        for k in range(1300):
            lost_m = 3.0 if k >= 300 else 0.0
            yield fix(x=0.05 * k - lost_m, y=0.55 if k >= 300 else 0.0)

    answers = run(make_follower(straight(kit), AHEAD_M, rules=ReplanRules(lateral_m=0.549)), fixes())
    events = [k for k, tracking in enumerate(answers) if tracking.replan]
    assert events[0] == 300
    # The vehicle stays 0.55 m beside the path while the trajectory goes back, so it is off again at its end.
    errors = [tracking.lateral_error_m for tracking in answers[301 : events[1]]]
    assert all(b > a - 1e-9 for a, b in itertools.pairwise(errors))
    assert errors[150] == pytest.approx(0.5 * 0.55, abs=0.02)
    assert 270 < events[1] - 300 <= 300
    # Time: 3 m behind for good, no error (the plan's clock is late), the speed as planned.
    assert all(abs(tracking.station_error_m) < 1e-6 for tracking in answers[301:])
    assert all(tracking.ref_speed_mps == pytest.approx(5.0) for tracking in answers[301:])


def test_speed_offset_fades_over_3_s(kit):
    def fixes():
        x = 0.0
        for k in range(800):
            speed = 5.0 if k < 200 else 3.0
            yield fix(x=x, y=0.6 if 200 <= k < 202 else 0.0, speed=speed)
            x += speed * DT_S

    answers = run(make_follower(straight(kit), AHEAD_M, rules=ReplanRules(station_m=90.0)), fixes())
    assert [k for k, tracking in enumerate(answers) if tracking.replan] == [200]
    speeds = [tracking.ref_speed_mps for tracking in answers[201:520]]
    assert speeds[0] == pytest.approx(3.0, abs=0.001)
    assert speeds[149] == pytest.approx(4.0, abs=0.01)
    assert speeds[300] == 5.0
    assert speeds == sorted(speeds)
    # The station is the integral of the speed: what the vehicle loses is what it is slower.
    loss = sum((tracking.ref_speed_mps - 3.0) * DT_S for tracking in answers[201:700])
    assert answers[700].station_error_m - answers[201].station_error_m == pytest.approx(loss, abs=0.002)


def test_hold_off_of_one_second(kit):
    fixes = [fix(x=0.05 * k, y=0.6 * (-1.0) ** (k // 20)) for k in range(900)]
    events = [k for k, tracking in enumerate(run(make_follower(straight(kit), AHEAD_M), fixes)) if tracking.replan]
    assert events[0] == 0
    assert len(events) > 3
    assert min(b - a for a, b in itertools.pairwise(events)) >= 100


def test_blended_reference_is_a_real_curve(kit):
    """On the blended trajectory itself, driven with its own heading and curvature, there is no error."""
    course = kit.course(20.0, lambda t: 5.0, lambda station: 0.03)
    block = make_follower(course, 0.0)
    state = block.init(block.params, DT_S)
    x, y, heading, done = 0.0, 0.55, 0.0, []
    state, tracking = block.step(block.params, state, (0, fix(x, y, heading)), DT_S)
    assert tracking.replan == 1.0
    for k in range(1, 500):
        curvature = tracking.ref_curvature_1pm if k > 1 else 0.03 / (1.0 - 0.03 * 0.55)
        x += 5.0 * DT_S * math.cos(heading + 0.5 * curvature * 5.0 * DT_S)
        y += 5.0 * DT_S * math.sin(heading + 0.5 * curvature * 5.0 * DT_S)
        heading += curvature * 5.0 * DT_S
        state, tracking = block.step(block.params, state, (k, fix(x, y, heading)), DT_S)
        done.append((tracking.lateral_error_m, tracking.heading_error_rad, tracking.path_lateral_error_m))
    assert max(abs(row[0]) for row in done) < 0.02
    assert max(abs(row[1]) for row in done) < 0.01
    assert abs(done[-1][2]) < 0.02  # and it leads back to the path


def test_overrunning_a_stop_replans_to_a_wait_where_it_stands(kit):
    """3 m past the stop line: the reference waits there until the plan pulls away, and then goes on from there."""

    def speed(t):
        return 2.0 if t < 4.0 else max(0.0, 6.0 - t) if t < 9.0 else min(2.0, t - 9.0)

    def fixes():
        for k in range(1100):
            yield fix(x=min(0.02 * k, 13.0), speed=2.0 if k < 650 else 0.0)

    answers = run(make_follower(kit.course(15.0, speed), AHEAD_M), fixes())
    first = next(k for k, tracking in enumerate(answers) if tracking.replan)
    assert 600 < first < 650
    last = max(k for k, tracking in enumerate(answers) if tracking.replan)
    assert abs(answers[last + 1].station_error_m) < 0.05
    # Once the speed offset of the re-plan has faded, only a constant offset of the station is left.
    assert answers[890].ref_speed_mps == pytest.approx(0.0, abs=0.2)
    assert abs(answers[890].path_remaining_m - answers[890].station_error_m) < 1e-9  # the stop has moved with it
    assert answers[1050].ref_speed_mps > 1.0
