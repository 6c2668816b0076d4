"""Effects on the body, and of sensing and time, have the size that their parameters say."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.tools.gap_exam.drives_for_tests import TICK_S, clean, hidden, runs, softened, vehicle
from tools.gap_exam import chassis
from tools.gap_exam.car import draw_vehicle
from tools.gap_exam.chassis import ACROSS, ALONG, SIDE, SPEED, YAW, chassis_of, first_body, step_body
from tools.gap_exam.hidden import NOTHING, Hidden, hidden_of
from tools.gap_exam.simulate import (
    ACCEL,
    INS_ACCEL,
    INS_SPEED,
    INS_X,
    INS_YAW,
    LATERAL,
    REPORT_SPEED,
    REPORT_YAW,
    STEER_OUT,
    WHEEL_RR,
)

pytestmark = pytest.mark.slow


# --- the body --------------------------------------------------------------------------------------------------------


def rolled(h: Hidden, speed: float, drive_n: float = 0.0, angle: float = 0.0, steps: int = 1) -> np.ndarray:
    """The body after some steps."""
    car = vehicle().car
    c, body = chassis_of(car, h), first_body(speed)
    for _ in range(steps):
        step_body(c, body, angle, drive_n, 0.0, car.wheelbase_m)
    return body


def lost(h: Hidden, speed: float) -> float:
    """Deceleration [m/s2] that a coasting car has on top of its own."""
    dt = 1.5e-3  # the first step of Adams-Bashforth
    return (rolled(NOTHING, speed)[SPEED] - rolled(h, speed)[SPEED]) / dt


def test_forces_along_the_car() -> None:
    car = vehicle().car
    mass = car.mass_kg
    assert lost(hidden(aero_drag=1.5), 20.0) == pytest.approx(0.5 * 1.2 * 1.5 * 400.0 / mass)
    assert lost(hidden(grade=0.03), 10.0) == pytest.approx(9.81 * math.sin(0.03), rel=1e-3)
    assert lost(hidden(rolling_resistance=0.5), 10.0) == pytest.approx(0.5 * car.rolling_frac * 9.81)
    wind = 0.5 * 1.2 * car.drag_area_m2 * (25.0**2 - 20.0**2) / mass
    assert lost(hidden(head_wind=5.0), 20.0) == pytest.approx(wind)
    assert lost(hidden(head_wind=-5.0), 20.0) < 0.0, "from behind"


def test_a_slope_and_a_bank_are_felt_by_an_accelerometer() -> None:
    flat, slope = rolled(NOTHING, 10.0, steps=50), rolled(hidden(grade=0.04), 10.0, steps=50)
    assert slope[ALONG] == pytest.approx(flat[ALONG], abs=0.01), "a car that coasts on a slope falls freely"
    assert slope[chassis.RATE] == pytest.approx(flat[chassis.RATE] - 9.81 * math.sin(0.04), abs=0.01)
    standing = rolled(hidden(road_bank=0.05), 0.0)
    assert standing[ACROSS] == pytest.approx(9.81 * math.sin(0.05)), "left side up: pushed to the left by the road"
    assert rolled(hidden(road_bank=0.05), 15.0)[SIDE] < 0.0, "it slides to the right"


def test_payload() -> None:
    car = vehicle().car
    h = hidden_of({"payload": {"mass_kg": 400.0, "ahead_m": -0.8}})
    c = chassis_of(car, h)
    assert c.mass_kg == pytest.approx(car.mass_kg + 400.0)
    moved = 400.0 * -0.8 / c.mass_kg
    assert c.front_m == pytest.approx(car.front_m - moved) and c.front_m > car.front_m
    about = car.inertia_kgm2 + car.mass_kg * moved**2 + 400.0 * (-0.8 - moved) ** 2
    assert c.inertia_kgm2 == pytest.approx(about), "parallel axes"
    quick = [(rolled(one, 5.0, 3000.0)[SPEED] - rolled(one, 5.0)[SPEED]) / 1.5e-3 for one in (NOTHING, h)]
    assert quick[1] / quick[0] == pytest.approx(car.mass_kg / c.mass_kg)


def turned(h: Hidden, speed: float = 14.0, angle: float = 0.004) -> float:
    """Steady yaw rate over steering angle; the speed is held."""
    car = vehicle().car
    c, body = chassis_of(car, h), first_body(speed)
    for _ in range(4000):
        step_body(c, body, angle, 0.0, 0.0, car.wheelbase_m)
        body[SPEED] = speed
    return float(body[YAW]) / angle


@pytest.mark.parametrize(("front", "rear"), [(1.0, 1.0), (0.7, 1.0), (1.0, 1.3)])
def test_stiffness_moves_understeer_as_the_formula_says(front: float, rear: float) -> None:
    car = vehicle().car
    behind = car.wheelbase_m - car.front_m
    front_n, rear_n = 2.0 * front * car.front_stiffness, 2.0 * rear * car.rear_stiffness
    bend = car.mass_kg / car.wheelbase_m * (behind / front_n - car.front_m / rear_n)
    wanted = 14.0 / (car.wheelbase_m + bend * 14.0**2)
    assert turned(hidden(front_stiffness=front, rear_stiffness=rear)) == pytest.approx(wanted, rel=0.01)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_friction_limits_the_turn(share: float) -> None:
    car = vehicle().car
    c, body = chassis_of(car, hidden(friction=share)), first_body(15.0)
    most = 0.0
    for angle in np.linspace(0.0, 0.2, 8000):
        step_body(c, body, angle, 0.0, 0.0, car.wheelbase_m)
        body[SPEED] = 15.0
        most = max(most, abs(body[ACROSS]))
    assert most == pytest.approx(share * car.friction * 9.81, rel=0.06)


def test_relaxation_takes_its_length_of_way() -> None:
    car = vehicle().car
    c, body = chassis_of(car, hidden(tyre_relaxation=0.8)), first_body(16.0)
    full = first_body(16.0)
    chassis.side_forces(chassis_of(car, NOTHING), full, 0.01, 0.0, 0.0)
    for _ in range(50):  # 0.8 m at 16 m/s
        chassis.side_forces(c, body, 0.01, 0.0, 0.0)
    assert body[chassis.TYRES] / full[chassis.TYRES] == pytest.approx(1.0 - math.exp(-1.0), rel=1e-6)


def test_wind_from_the_side() -> None:
    body = rolled(hidden(side_wind=800.0), 12.0)
    assert body[SIDE] / 1.5e-3 == pytest.approx(800.0 / vehicle().car.mass_kg), "to the left"


# --- sensing and time ------------------------------------------------------------------------------------------


def test_scales_and_biases_are_in_their_reports_only() -> None:
    changes = {
        "speed_scale": (0.95, slice(REPORT_SPEED, WHEEL_RR + 1), lambda x: 0.95 * x),
        "yaw_rate_bias": (0.02, REPORT_YAW, lambda x: x + 0.02),
        "yaw_rate_scale": (1.1, REPORT_YAW, lambda x: 1.1 * x),
        "accel_bias": (-0.3, ACCEL, lambda x: x - 0.3),
        "steer_report_offset": (0.05, STEER_OUT, lambda x: x + 0.05),
    }
    for name, (value, columns, change) in changes.items():
        without, with_it = runs(**{name: value})
        assert np.allclose(with_it[:, columns], change(without[:, columns]), atol=1e-12), name
        others = np.ones(without.shape[1], dtype=bool)
        others[columns] = False
        assert np.array_equal(with_it[:, others], without[:, others]), name


def test_yaw_rate_filter() -> None:
    without, with_it = runs(yaw_rate_filter=0.2)
    size = np.abs(without[:, REPORT_YAW]).max()
    assert np.abs(with_it[:, REPORT_YAW] - softened(without[:, REPORT_YAW], 0.2)).max() < 0.01 * size
    assert np.array_equal(with_it[:, INS_YAW], without[:, INS_YAW])


@pytest.mark.parametrize(("name", "late"), [("report_latency", slice(0, INS_X)), ("ins_latency", slice(INS_X, 20))])
def test_latency_is_of_every_frame_of_its_side(name: str, late: slice) -> None:
    """Whole ticks, so that no straight line lies between two values; echoes of commands are late, too."""
    without, with_it = runs(**{name: 0.07})
    columns = np.arange(20)[late]
    assert np.allclose(with_it[7:, columns], without[:-7, columns], atol=1e-3)
    others = np.setdiff1d(np.arange(20), columns)
    assert np.array_equal(with_it[:, others], without[:, others])


def test_the_clean_car_is_consistent() -> None:
    """Speed is the integral of its rate, yaw that of its rate, lateral acceleration v times r within the slip."""
    made = clean()
    reports = made.drive.reports
    speed = np.cumsum(reports[:, INS_ACCEL]) * TICK_S
    assert np.abs((reports[:, INS_SPEED] - reports[0, INS_SPEED]) - speed).max() < 0.35
    turning = reports[:, INS_SPEED] > 3.0
    off = reports[turning, LATERAL] - reports[turning, INS_SPEED] * reports[turning, INS_YAW]
    assert np.abs(off).mean() < 0.15


# --- the background ----------------------------------------------------------------------------------------------


def side_n(number: int, mismatch: float, slip: float, accel_mps2: float) -> float:
    """Side force of the front axle at a slip angle, load moved across as that lateral acceleration does."""
    c = chassis_of(draw_vehicle(number, mismatch).car, NOTHING)
    moved = c.transfer * accel_mps2 * c.mass_kg * c.rear_m / (c.front_m + c.rear_m)
    loads = (c.front_n - moved, c.front_n + moved)
    return sum(chassis.tyre_n(c, slip, c.front_stiffness, c.front_n, load, 0.0) for load in loads)


@pytest.mark.parametrize("mismatch", [0.02, 0.05])
def test_background_mismatch_is_about_what_it_says(mismatch: float) -> None:
    """At 4 m/s2 to the side: what tyre form and load transfer take off, against the same car without."""
    short = []
    for number in range(12):
        car = draw_vehicle(number, 0.0).car
        needed = 4.0 * car.mass_kg * (car.wheelbase_m - car.front_m) / car.wheelbase_m
        slips = np.linspace(0.0, 0.2, 2001)
        slip = slips[np.argmax([side_n(number, 0.0, one, 4.0) > needed for one in slips])]
        short.append(1.0 - side_n(number, mismatch, slip, 4.0) / side_n(number, 0.0, slip, 4.0))
    assert np.mean(short) == pytest.approx(mismatch, rel=0.3)
    assert 0.6 * mismatch < min(short) and max(short) < 1.6 * mismatch


def test_a_car_without_mismatch_has_none_of_the_awkward_parts() -> None:
    car = draw_vehicle(1, 0.0).car
    assert (car.height_m, car.brush_frac, car.slip_per_n, car.gear_ripple, car.brake_rise) == (0.0,) * 5
    assert (car.load_slope, car.power_bend, car.power_edge) == (0.0, 1.0, 2.0)
