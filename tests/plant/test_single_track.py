"""The nominal car against closed forms."""

from __future__ import annotations

import itertools
import math

import pytest

from tests.plant.drives import REST, car, command, drive
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.plant.data_sheet import DEFAULTS
from tunefree_hil.plant.single_track import PLANT, axle_n
from tunefree_hil.plant.vehicle import steady_accel

MASS, BASE = DEFAULTS["mass_kg"], DEFAULTS["wheelbase_m"]


def holding_throttle(speed_mps: float) -> float:
    """Throttle that keeps the speed on a straight road, by bisection."""
    low, high = REST, 0.8
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if steady_accel(PLANT, {}, speed_mps, middle, REST) < 0.0 else (low, middle)
    return high


@pytest.mark.parametrize("speed", [4.0, 8.0, 15.0, 25.0])
@pytest.mark.parametrize(("front", "rear"), [(155494.663, 155494.663), (110e3, 160e3)])
def test_steady_cornering(speed: float, front: float, rear: float) -> None:
    """yaw rate = v delta / (L + K v^2), K = m (lr Cr - lf Cf) / (Cf Cr L); small angles."""
    params = {"front_stiffness_n_per_rad": front, "rear_stiffness_n_per_rad": rear}
    road_wheel = 0.15 * BASE / speed**2
    throttle = holding_throttle(speed)
    body = car("physics", params)
    last = drive(body, lambda t: command(throttle, REST, 16.0 * road_wheel), 5.0, start=Start(speed_mps=speed))[-1]
    arm = DEFAULTS["front_axle_m"]
    gradient = MASS * ((BASE - arm) * rear - arm * front) / (front * rear * BASE)
    v = last.motion.speed_mps
    assert last.motion.yaw_rate_radps == pytest.approx(v * road_wheel / (BASE + gradient * v * v), rel=2e-3)
    assert last.motion.lateral_accel_mps2 == pytest.approx(v * last.motion.yaw_rate_radps, rel=1e-4)


def test_kinematic_at_walking_pace() -> None:
    outputs = drive(car("physics"), lambda t: command(REST, REST, 4.8), 3.0, start=Start(speed_mps=0.2))
    for out in outputs[80:]:
        motion = out.motion
        if motion.speed_mps < 0.5:
            steer = out.actuation.steer_rad / 16.0
            assert motion.yaw_rate_radps == pytest.approx(motion.speed_mps * math.tan(steer) / BASE, rel=1e-9)


@pytest.mark.parametrize("wheel_rad", [0.05, -0.2, 0.35])
def test_a_linkage_that_bends_turns_the_road_wheels_less_by_a_share_per_square(wheel_rad: float) -> None:
    bent = car("physics", {"linkage_bend": 0.3})
    straight, less = car("physics"), wheel_rad * (1.0 - 0.3 * wheel_rad**2)
    found, same = (
        drive(one, lambda t, angle=angle: command(0.2, REST, 16.0 * angle), 3.0, start=Start(speed_mps=3.0))[-1].motion
        for one, angle in ((bent, wheel_rad), (straight, less))
    )
    assert found.yaw_rate_radps == pytest.approx(same.yaw_rate_radps, rel=2e-4)
    assert abs(found.yaw_rate_radps) > 0.01


def test_the_blend_to_the_dynamic_model_does_not_jerk() -> None:
    outputs = drive(car("physics"), lambda t: command(0.25, REST, 3.0), 4.0, start=Start(speed_mps=0.3))
    assert outputs[-1].motion.speed_mps > 3.0
    accels = [out.motion.lateral_accel_mps2 for out in outputs[30:]]
    assert max(abs(b - a) for a, b in itertools.pairwise(accels)) < 0.05


def test_axle_force_is_linear_then_flat() -> None:
    assert axle_n(0.001, 1e5, 8000.0) == pytest.approx(100.0, rel=1e-3)
    assert axle_n(10.0, 1e5, 8000.0) == pytest.approx(8000.0, rel=1e-3)
    assert axle_n(-0.05, 1e5, 8000.0) == -axle_n(0.05, 1e5, 8000.0)


def test_brake_is_linear_and_capped_by_friction() -> None:
    rates = [steady_accel(PLANT, {}, 10.0, REST, brake) for brake in (0.20, 0.25, 0.30)]
    slope = DEFAULTS["brake_force_n_per_frac"] / MASS
    assert rates[0] - rates[1] == pytest.approx(0.05 * slope, rel=1e-3)
    assert rates[1] - rates[2] == pytest.approx(0.05 * slope, rel=1e-3)
    assert steady_accel(PLANT, {}, 10.0, REST, 0.9) == pytest.approx(-0.9 * 9.80665 - 0.14, abs=0.01)


def test_a_progressive_brake_grows_beyond_proportion() -> None:
    """F = gain b (1 + rise b), b the duty from rest."""
    for brake in (0.05, 0.1):
        loss = steady_accel(PLANT, {}, 10.0, REST, REST + brake) - steady_accel(
            PLANT, {"brake_rise_per_frac": 0.8}, 10.0, REST, REST + brake
        )
        assert loss * MASS == pytest.approx(DEFAULTS["brake_force_n_per_frac"] * 0.8 * brake**2, rel=2e-3)


def test_drive_is_power_limited_and_grows_with_the_pedal() -> None:
    drag = DEFAULTS["drag_area_m2"] * 0.6
    rolling = DEFAULTS["rolling_frac"] * MASS * 9.80665
    for speed in (20.0, 30.0):
        force = steady_accel(PLANT, {}, speed, 0.8, REST) * MASS + rolling + drag * speed**2
        assert 0.6 < force * speed / DEFAULTS["drive_power_w"] <= 1.0
    rows = [steady_accel(PLANT, {}, speed, 0.5, REST) for speed in (0.0, 2.0, 5.0, 10.0, 20.0)]
    assert rows == sorted(rows, reverse=True)
    pedals = [steady_accel(PLANT, {}, 5.0, 0.15 + 0.05 * i, REST) for i in range(1, 14)]
    assert pedals == sorted(pedals)


@pytest.mark.parametrize(("speed", "share"), [(1.5, 0.0), (2.0, 0.0), (3.0, 0.5), (4.0, 1.0), (20.0, 1.0)])
def test_overrun_fades_in_above_creep_and_lets_go_with_the_pedal(speed: float, share: float) -> None:
    """F_o min(v / v_creep - 1, 1) exp(-t / knee), t the throttle's share from zero to full."""
    held = {"overrun_force_n": 500.0, "creep_speed_mps": 2.0}
    for duty in (REST, 0.165, 0.22):
        loss = steady_accel(PLANT, {}, speed, duty, REST) - steady_accel(PLANT, held, speed, duty, REST)
        pressed = math.exp(-max(duty - 0.165, 0.0) / (0.80 - 0.165) / DEFAULTS["drive_knee_frac"])
        assert loss * MASS == pytest.approx(500.0 * share * pressed, abs=1.5)


@pytest.mark.parametrize("corner", [1.5, 4.0, 20.0, 128.0])
def test_a_sharp_corner_is_force_below_it_and_power_above(corner: float) -> None:
    free = {"rolling_frac": 0.0, "drag_area_m2": 0.0, "drive_corner": corner}
    full, power = 6500.0 * (1.0 - math.exp(-1.0 / DEFAULTS["drive_knee_frac"])), DEFAULTS["drive_power_w"]
    for speed in (3.0, 14.0, 15.0, 30.0):
        asked = full * speed / power
        expected = full / (1.0 + asked**corner) ** (1.0 / corner)
        assert steady_accel(PLANT, free, speed, 0.8, REST) * MASS == pytest.approx(expected, rel=2e-3)
    crawling = steady_accel(PLANT, {**free, "drive_power_w": 50.0}, 30.0, 0.8, REST)
    assert crawling * MASS == pytest.approx(50.0 / 30.0, abs=2.0), "no power of a large number overflows"


def test_unknown_parameter() -> None:
    with pytest.raises(InputError) as caught:
        car("physics", {"mass": 1.0})
    assert caught.value.key == "plant.params.mass" and "mass_kg" in caught.value.hint
