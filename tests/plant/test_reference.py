"""The reference vehicle against the published tables, its closed forms, and its awkward facts."""

from __future__ import annotations

import itertools
import math

import pytest

from tests.plant.drives import REST, car, command, drive
from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import GEAR_DRIVE, Actuation, Disturbance
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.plant.reference import PLANT
from tunefree_hil.plant.reference_vehicle.car import DEFAULTS
from tunefree_hil.plant.reference_vehicle.maps import (
    AS_PUBLISHED,
    BRAKE_NM,
    SPEEDS_MPS,
    THROTTLE_FRAC,
    THROTTLE_MPS2,
    TOOTH_FRAC,
    Gearbox,
    MapShape,
    first_gearbox,
    gear_factor,
    maps_of,
    step_gearbox,
    table_duty,
)
from tunefree_hil.plant.types import ChassisInput
from tunefree_hil.plant.vehicle import steady_accel

AT_ONCE = {"drive_lag_s": 0.0}
BODY = car("reference")

# docs/reference/apollo.md, point (b): mean deceleration over 2..10 m/s by brake duty
MEAN_BRAKING = {0.20: -0.33, 0.22: -0.68, 0.25: -1.79, 0.27: -2.64, 0.30: -4.75, 0.33: -7.55, 0.35: -8.94}


def accel(speed_mps: float, throttle: float = REST, brake: float = REST) -> float:
    return steady_accel(PLANT, AT_ONCE, speed_mps, throttle, brake, dt_s=0.001)


def mean_braking(duty: float) -> float:
    speeds = [2.0 + 0.5 * i for i in range(17)]
    return sum(accel(speed, brake=duty) for speed in speeds) / len(speeds)


@pytest.mark.parametrize("row", range(len(SPEEDS_MPS)))
def test_throttle_follows_the_calibration_table(row: int) -> None:
    """Within what the gearbox's saw tooth makes of it (3 % of the drive) and 0.02 m/s^2."""
    for duty, wanted in zip(THROTTLE_FRAC[1:], THROTTLE_MPS2[row], strict=True):
        got = accel(SPEEDS_MPS[row], throttle=duty)
        assert got == pytest.approx(wanted, abs=0.03 + 0.5 * TOOTH_FRAC * abs(wanted)), f"{duty}"


def test_coasting_creeps() -> None:
    wanted = {0.0: 0.40, 1.0: 0.28, 2.0: -0.05, 5.0: -0.19, 10.0: -0.27}
    assert {speed: accel(speed) for speed in wanted} == pytest.approx(wanted, abs=0.01)


@pytest.mark.parametrize(("duty", "tolerance"), [(0.20, 0.05), (0.25, 0.05), (0.27, 0.10), (0.30, 0.40)])
def test_brake_follows_the_calibration_table(duty: float, tolerance: float) -> None:
    assert mean_braking(duty) == pytest.approx(MEAN_BRAKING[duty], abs=tolerance)


def test_where_the_two_published_brake_tables_disagree() -> None:
    """The car follows the torque table: too strong at 0.22, and flat above 0.326, where the other goes on."""
    assert mean_braking(0.22) - MEAN_BRAKING[0.22] == pytest.approx(-0.41, abs=0.05)
    assert mean_braking(0.33) - MEAN_BRAKING[0.33] == pytest.approx(1.5, abs=0.1)
    assert mean_braking(0.35) == mean_braking(0.33)


def test_brake_torque_table() -> None:
    """Force times wheel radius is the table's torque: dead band to 0.175, a step of 400 Nm at 0.21."""
    for duty, torque in ((0.16, 0.0), (0.175, 0.0), (0.208, 108.0), (0.211, 519.0), (0.246, 816.0), (0.305, 2612.0)):
        braked = (accel(8.0) - accel(8.0, brake=duty)) * DEFAULTS["mass_kg"] * 0.335
        assert braked == pytest.approx(torque, abs=4.0)


def test_power_is_constant_above_the_table() -> None:
    def power(speed: float, duty: float) -> float:
        factor = gear_factor(maps_of(0.01, 0.7, 0.335), first_gearbox(speed), speed)
        return (accel(speed, throttle=duty) - accel(speed)) / factor * speed

    for duty in (0.25, 0.40, 0.80):
        assert power(12.0, duty) == pytest.approx(power(28.0, duty), rel=1e-3)


def test_gearbox_shifts_with_hysteresis_and_a_hole() -> None:
    maps = maps_of(0.01, 0.7, 0.335)
    box = Gearbox(0.0, 0.0)
    assert step_gearbox(maps, box, 0.2, 4.4, 0.001).gear == 0.0
    box = step_gearbox(maps, box, 0.2, 4.6, 0.001)
    assert box.gear == 1.0 and box.shift_s > 0.0
    assert gear_factor(maps, Gearbox(1.0, 0.5 * box.shift_s), 4.6) < 0.75 < gear_factor(maps, Gearbox(1.0, 0.0), 4.6)
    box = Gearbox(1.0, 0.0)
    assert step_gearbox(maps, box, 0.2, 4.0, 0.001).gear == 1.0
    assert step_gearbox(maps, box, 0.2, 3.5, 0.001).gear == 0.0
    assert step_gearbox(maps, Gearbox(0.0, 0.0), 0.8, 5.5, 0.001).gear == 0.0, "full throttle shifts later"


def test_gear_steps_show_in_a_launch() -> None:
    outputs = drive(BODY, lambda t: command(0.5), 8.0)
    assert outputs[-1].motion.speed_mps > 13.0
    accels = [out.motion.speed_rate_mps2 for out in outputs]
    holes = [k for k in range(100, 760) if accels[k] < min(accels[k - 20], accels[k + 25]) - 0.1]
    separate = [k for k, before in zip(holes, [0, *holes], strict=False) if k > before + 30]
    assert len(separate) == 2, "from first to second and on to third gear"


@pytest.mark.parametrize("speed", [5.0, 10.0, 18.0])
def test_steady_cornering_understeers(speed: float) -> None:
    """yaw rate = v delta / (L + K v^2) with the compliance of the steering in K."""
    base, arm, mass = DEFAULTS["wheelbase_m"], DEFAULTS["front_axle_m"], DEFAULTS["mass_kg"]
    front, rear = DEFAULTS["front_stiffness_n_per_rad"], DEFAULTS["rear_stiffness_n_per_rad"]
    gradient = mass * ((base - arm) * rear - arm * front) / (front * rear * base)
    gradient += DEFAULTS["compliance_rad_per_n"] * mass * (base - arm) / base
    assert gradient > 0.002
    road_wheel = 0.6 * (base + gradient * speed**2) / speed**2
    for throttle in (0.15 + 0.002 * i for i in range(100)):
        if accel(speed, throttle=throttle) > 0.0:
            break
    outputs = drive(BODY, lambda t: command(throttle, REST, 16.0 * road_wheel), 4.0, start=Start(speed_mps=speed))
    last = outputs[-1].motion
    v = last.speed_mps
    assert last.yaw_rate_radps == pytest.approx(v * road_wheel / (base + gradient * v * v), rel=0.03)


def test_steering_answers_late_then_slowly_then_at_its_rate() -> None:
    small = drive(BODY, lambda t: command(steer=0.2), 1.0, start=Start(speed_mps=5.0))
    angles = [out.actuation.steer_rad for out in small]
    assert angles[10] == 0.0 < angles[11] and angles[-1] == pytest.approx(0.2, rel=1e-3)
    caught = next(k for k, angle in enumerate(angles) if angle > 0.2 * (1.0 - math.exp(-1.0))) * 0.01
    assert 0.1 + 0.07 < caught < 0.1 + 0.07 + 0.03
    large = [out.actuation.steer_rad for out in drive(BODY, lambda t: command(steer=8.0), 1.0)]
    fastest = max(b - a for a, b in itertools.pairwise(large)) / 0.01
    assert fastest == pytest.approx(8.55, rel=1e-3)


def test_pedals_press_slower_than_they_let_go() -> None:
    outputs = drive(BODY, lambda t: command(brake=0.25 if t < 1.0 else REST), 2.0, start=Start(speed_mps=9.0))
    brake = [out.actuation.brake_frac - REST for out in outputs]
    pressed = next(k for k, duty in enumerate(brake) if duty > 0.08)
    released = next(k for k, duty in enumerate(brake[100:]) if duty < 0.02)
    assert pressed > released > 2


def test_brake_hysteresis() -> None:
    """Coming from more pedal the same pedal brakes harder, by the play's width."""

    def braking(first: float) -> float:
        commands = lambda t: command(brake=first if t < 0.6 else 0.27)  # noqa: E731
        return drive(BODY, commands, 1.4, start=Start(speed_mps=14.0))[-1].motion.speed_rate_mps2

    played = accel(8.0, brake=0.27 + DEFAULTS["hysteresis_frac"])
    assert braking(0.30) == pytest.approx(played, abs=0.05)
    assert braking(0.24) == pytest.approx(accel(8.0, brake=0.27), abs=0.05)


def test_load_goes_to_the_outer_wheels() -> None:
    body = car("reference")
    outputs = drive(body, lambda t: command(0.25, REST, 1.5), 3.0, start=Start(speed_mps=12.0))
    soft = car("reference", {"height_m": 0.01})
    flat = drive(soft, lambda t: command(0.25, REST, 1.5), 3.0, start=Start(speed_mps=12.0))
    assert abs(outputs[-1].motion.lateral_accel_mps2) > 3.0
    assert outputs[-1].motion.yaw_rate_radps < flat[-1].motion.yaw_rate_radps, "front-heavy roll support understeers"


def test_braking_in_a_turn_uses_up_side_grip() -> None:
    wet = Disturbance(0.0, 0.5)

    def turning(brake: float) -> float:
        commands = lambda t: command(REST, brake if t > 1.5 else REST, 4.0)  # noqa: E731
        outputs = drive(BODY, commands, 2.0, start=Start(speed_mps=14.0), road=wet)
        return abs(outputs[-1].motion.lateral_accel_mps2)

    assert turning(0.32) < 0.8 * turning(REST)


def test_the_published_shape_changes_no_bit() -> None:
    """Another vehicle's factors are 1 for the car of the tables: the same numbers bit for bit, not nearly."""
    assert maps_of(0.01, 0.7, 0.335, AS_PUBLISHED) == maps_of(0.01, 0.7, 0.335)
    assert [float(nm) for nm in maps_of(0.01, 0.7, 0.335).brake_n] == [nm / 0.335 for nm in BRAKE_NM]
    for duty in (0.15, 0.1737, 0.2999999, 0.8):
        assert table_duty(duty, 0.15, 1.0) == duty
    assert table_duty(0.0, 0.0, 0.65) == 0.15 and table_duty(1.0, 0.0, 0.65) == pytest.approx(0.80)


OTHER = {**AT_ONCE, "rest_pedal_frac": 0.0, "throttle_scale": 0.65, "brake_scale": 0.25}


@pytest.mark.parametrize("speed_mps", [0.5, 6.0, 12.0])
def test_a_pedal_of_another_scale_does_the_same(speed_mps: float) -> None:
    """Per cent of a pedal instead of raw duty: the same push and the same braking at the duty that it stands for."""
    for duty in (0.0, 0.3, 0.9):
        got = steady_accel(PLANT, OTHER, speed_mps, duty, 0.0, dt_s=0.001)
        assert got == pytest.approx(accel(speed_mps, throttle=0.15 + 0.65 * duty), abs=1e-9)
        got = steady_accel(PLANT, OTHER, speed_mps, 0.0, duty, dt_s=0.001)
        assert got == pytest.approx(accel(speed_mps, brake=0.15 + 0.25 * duty), abs=1e-9)


def test_drums_pull_themselves_on() -> None:
    """With a servo the force grows faster than the pedal; at the table's end it is 1 + servo times as much."""
    plain, drum = maps_of(0.01, 0.7, 0.335), maps_of(0.01, 0.7, 0.335, MapShape(brake_gain=1.5, brake_servo=0.4))
    shares = [float(b) / float(a) for a, b in zip(plain.brake_n, drum.brake_n, strict=True) if float(a) > 0.0]
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1.5 * 1.4) and shares[0] == pytest.approx(1.5, 1e-2)


def test_gains_scale_what_they_say() -> None:
    weak = {**AT_ONCE, "drive_gain": 0.5}
    push = steady_accel(PLANT, weak, 5.0, 0.35, REST, dt_s=0.001) - accel(5.0)
    assert push == pytest.approx(0.5 * (accel(5.0, throttle=0.35) - accel(5.0)), rel=1e-6)
    early = maps_of(0.01, 0.7, 0.335, MapShape(shift_gain=0.5))
    assert step_gearbox(early, Gearbox(0.0, 0.0), 0.2, 2.3, 0.001).gear == 1.0
    assert first_gearbox(2.3, 0.5).gear == 1.0 and first_gearbox(2.3).gear == 0.0


def test_rear_drive_leaves_the_front_wheels_their_grip() -> None:
    """On ice a driven front axle loses side force, a driven rear axle lets the tail step out: more yaw."""
    ice = Disturbance(0.0, 0.25)

    def turning(front_frac: float) -> float:
        body = car("reference", {"drive_front_frac": front_frac})
        outputs = drive(
            body, lambda t: command(0.5 if t > 1.0 else REST, REST, 2.0), 2.2, start=Start(speed_mps=8.0), road=ice
        )
        return abs(outputs[-1].motion.yaw_rate_radps)

    assert turning(0.0) > 1.05 * turning(1.0)


def test_an_accelerometer_feels_the_slope() -> None:
    still = drive(BODY, lambda t: command(REST, 0.3), 0.3, road=Disturbance(0.08, 1.0))[-1].motion
    assert still.speed_mps == 0.0 and still.accel_mps2 == pytest.approx(G_MPS2 * math.sin(0.08))


@pytest.mark.parametrize("friction", [1.0, 0.3])
def test_brakes_take_up_no_more_than_the_car_had(friction: float) -> None:
    """What a slipping tyre does not hand on heats no brake."""
    block = PLANT.make({}, BodyChange())
    params = block.params._replace(start=Start(speed_mps=15.0))
    state, motion = block.init(params, 0.001), None
    x = ChassisInput(Actuation(REST, 0.30, 0.0, GEAR_DRIVE), Disturbance(friction_frac=friction))
    while motion is None or motion.speed_mps > 0.0:
        state, motion = block.step(params, state, x, 0.001)
    had_j = 0.5 * DEFAULTS["mass_kg"] * 15.0**2
    assert 0.7 * had_j < state.braked_j < had_j
