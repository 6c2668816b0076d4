"""What holds for any car: both plants must obey it."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.plant.drives import DT_S, PLANTS, REST, car, command, drive
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import GEAR_NEUTRAL, Disturbance
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.plant.types import BodyOutput

KINDS = sorted(PLANTS)
BODIES = {kind: car(kind) for kind in KINDS}


def kinetic_j_per_kg(out: BodyOutput, inertia_per_kg_m2: float) -> float:
    motion = out.motion
    turning = inertia_per_kg_m2 * motion.yaw_rate_radps**2
    return 0.5 * (motion.speed_mps**2 + motion.side_speed_mps**2 + turning)


@pytest.mark.parametrize("kind", KINDS)
@given(st.floats(0.5, 20.0), st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3), st.floats(0.15, 0.5))
@settings(max_examples=8, deadline=None)
def test_energy_never_grows_without_drive(kind: str, speed: float, angles: list[float], brake: float) -> None:
    constants = BODIES[kind].block.params.chassis.constants
    inertia = constants.inverse_mass / constants.inverse_inertia
    outputs = drive(
        BODIES[kind],
        lambda t: command(0.5, brake, angles[min(int(t / 0.5), 2)], GEAR_NEUTRAL),
        1.5,
        start=Start(speed_mps=speed),
    )
    energies = [kinetic_j_per_kg(out, inertia) for out in outputs]
    assert all(later <= sooner for sooner, later in itertools.pairwise(energies))


@pytest.mark.parametrize("kind", KINDS)
def test_mirrored_steering_mirrors_the_path(kind: str) -> None:
    def weave(sign: float) -> list[BodyOutput]:
        return drive(
            BODIES[kind],
            lambda t: command(0.3, REST if t < 2.0 else 0.24, sign * 4.0 * math.sin(2.0 * t)),
            4.0,
            start=Start(speed_mps=9.0),
        )

    for left, right in zip(weave(1.0), weave(-1.0), strict=True):
        a, b = left.motion, right.motion
        assert (a.x_m, a.y_m, a.heading_rad) == pytest.approx((b.x_m, -b.y_m, -b.heading_rad), abs=1e-9)
        assert (a.speed_mps, a.side_speed_mps) == pytest.approx((b.speed_mps, -b.side_speed_mps), abs=1e-9)
        assert (a.wheel_fl_radps, a.wheel_rr_radps) == pytest.approx((b.wheel_fr_radps, b.wheel_rl_radps), abs=1e-9)
        assert (a.accel_mps2, a.lateral_accel_mps2) == pytest.approx((b.accel_mps2, -b.lateral_accel_mps2), abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_where_it_starts_and_looks_does_not_matter(kind: str) -> None:
    def drive_from(start: Start) -> BodyOutput:
        return drive(BODIES[kind], lambda t: command(0.3, REST, 2.0), 2.0, start=start)[-1]

    here, there = drive_from(Start(speed_mps=6.0)).motion, drive_from(Start(10.0, -4.0, 1.0, 6.0)).motion
    cosine, sine = math.cos(1.0), math.sin(1.0)
    assert there.x_m == pytest.approx(10.0 + here.x_m * cosine - here.y_m * sine)
    assert there.y_m == pytest.approx(-4.0 + here.x_m * sine + here.y_m * cosine)
    assert there.heading_rad == pytest.approx(1.0 + here.heading_rad)
    assert there.yaw_rate_radps == pytest.approx(here.yaw_rate_radps)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("grade", [0.0, 0.06, -0.06])
def test_stop_means_stop(kind: str, grade: float) -> None:
    outputs = drive(
        BODIES[kind],
        lambda t: command(REST, 0.30 if t < 5.0 else REST, 1.0),
        7.0,
        start=Start(speed_mps=8.0),
        road=Disturbance(grade, 1.0),
    )
    assert all(out.motion.speed_mps >= 0.0 for out in outputs)
    stopped = next(k for k, out in enumerate(outputs) if out.motion.speed_mps == 0.0)
    assert stopped < 400
    standing = outputs[stopped + 1 : 500]
    rest = standing[0].motion
    assert (rest.speed_mps, rest.side_speed_mps, rest.yaw_rate_radps, rest.speed_rate_mps2) == (0.0, 0.0, 0.0, 0.0)
    assert rest.accel_mps2 == pytest.approx(G_MPS2 * math.sin(grade))
    assert {out.motion for out in standing} == {rest}
    end = outputs[-1].motion
    if grade > 0.05:
        assert end == rest, "creep does not climb 6 %, and in drive it does not roll back"
    else:
        assert 0.2 < end.speed_mps < 3.0, "creeps off when the brake is let go"


@pytest.mark.parametrize("kind", KINDS)
def test_slope_and_friction(kind: str) -> None:
    def speed_after(grade: float) -> float:
        road = Disturbance(grade, 1.0)
        return drive(BODIES[kind], lambda t: command(), 1.0, start=Start(speed_mps=12.0), road=road)[
            -1
        ].motion.speed_mps

    level = speed_after(0.0)
    assert level - speed_after(0.05) == pytest.approx(G_MPS2 * math.sin(0.05), rel=0.03)
    assert speed_after(-0.05) - level == pytest.approx(G_MPS2 * math.sin(0.05), rel=0.03)
    ice = Disturbance(0.0, 0.1)
    braked = drive(BODIES[kind], lambda t: command(REST, 0.45), 1.0, start=Start(speed_mps=15.0), road=ice)
    assert braked[-1].motion.speed_rate_mps2 > -0.15 * G_MPS2
    turned = drive(BODIES[kind], lambda t: command(REST, REST, 3.0), 1.5, start=Start(speed_mps=15.0), road=ice)
    assert max(abs(out.motion.lateral_accel_mps2) for out in turned) < 0.12 * G_MPS2


@pytest.mark.parametrize("kind", KINDS)
def test_tyres_saturate(kind: str) -> None:
    outputs = drive(BODIES[kind], lambda t: command(0.3, REST, 8.0), 4.0, start=Start(speed_mps=25.0))
    most = max(abs(out.motion.lateral_accel_mps2) for out in outputs)
    assert 0.6 * G_MPS2 < most < 1.0 * G_MPS2
    assert all(math.isfinite(value) for out in outputs for value in out.motion)


@pytest.mark.parametrize("kind", KINDS)
def test_motion_is_consistent(kind: str) -> None:
    """Pose is the integral of the velocities, and speed of its rate; wheels roll with their hubs."""
    outputs = drive(BODIES[kind], lambda t: command(0.3, REST, 2.0 * math.sin(t)), 4.0, start=Start(speed_mps=7.0))
    last = outputs[-1].motion
    rates = [out.motion.yaw_rate_radps for out in outputs]
    assert last.heading_rad == pytest.approx(DT_S * (sum(rates) - 0.5 * (rates[0] + rates[-1])), abs=1e-4)
    driven = sum(math.dist((a.motion.x_m, a.motion.y_m), (b.motion.x_m, b.motion.y_m))
                 for a, b in itertools.pairwise(outputs))  # fmt: skip
    speeds = [out.motion.speed_mps for out in outputs]
    assert driven == pytest.approx(DT_S * (sum(speeds) - 0.5 * (speeds[0] + speeds[-1])), rel=1e-3)
    rear = 0.5 * (last.wheel_rl_radps + last.wheel_rr_radps) * 0.335
    assert rear == pytest.approx(last.speed_mps, rel=1e-3)
    assert (last.wheel_rr_radps - last.wheel_rl_radps) * 0.335 / 1.5824 == pytest.approx(last.yaw_rate_radps, rel=0.01)


@pytest.mark.parametrize(("kind", "bound_m"), [("physics", 0.02), ("reference", 0.005)])
def test_half_the_step_changes_little(kind: str, bound_m: float) -> None:
    """Same commands, held for 10 ms either way."""
    coarse = car(kind)
    fine = car(kind, substeps=2 * PLANTS[kind].substeps)

    def weave(t: float):
        return command(0.28 if t < 3.0 else REST, REST if t < 3.0 else 0.27, 3.0 * math.sin(1.5 * t))

    a = drive(coarse, weave, 6.0, start=Start(speed_mps=8.0))[-1].motion
    b = drive(fine, weave, 6.0, start=Start(speed_mps=8.0))[-1].motion
    assert math.dist((a.x_m, a.y_m), (b.x_m, b.y_m)) < bound_m
    assert abs(a.heading_rad - b.heading_rad) < bound_m / 5.0
    assert abs(a.speed_mps - b.speed_mps) < bound_m
