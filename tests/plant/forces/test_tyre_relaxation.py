"""The step of relaxing tyres against their equations, integrated finely, and against smaller steps of its own."""

from __future__ import annotations

import math

import pytest

from tests.plant.drives import PLANTS, REST, car, command, drive
from tunefree_hil.base.contracts import BodyChange, Port, make_effect
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import GEAR_NEUTRAL, Actuation, Disturbance, Motion
from tunefree_hil.effects import catalogue
from tunefree_hil.plant.data_sheet import SingleTrack
from tunefree_hil.plant.types import ChassisInput

STEER_RAD = 0.04
PART = {"front_stiffness_n_per_rad": 120e3, "rear_stiffness_n_per_rad": 160e3}


def stepped(length_m: float, speed: float, ticks: int) -> tuple[SingleTrack, list[Motion]]:
    """The chassis after a step of the steering, out of gear."""
    block = PLANTS["physics"].make(PART, BodyChange(relaxation_m=length_m))
    params = block.params._replace(start=Start(speed_mps=speed))
    state, motions = block.init(params, 0.01), []
    x = ChassisInput(Actuation(REST, REST, STEER_RAD, GEAR_NEUTRAL), Disturbance())
    for _ in range(ticks):
        state, motion = block.step(params, state, x, 0.01)
        motions.append(motion)
    return params.constants, motions


def integrated(p: SingleTrack, length_m: float, speeds: list[float]) -> list[tuple[float, float]]:
    """(side speed, yaw rate) at the ticks: m (s' + v r) = F + R, I r' = a F - b R, F' = (F0 - F) v / length."""
    side = yaw = front = rear = 0.0
    found, fine, a, b = [], 400, p.front_axle_m, p.rear_axle_m
    dt_s = 0.01 / fine
    for v in speeds:
        for _ in range(fine):
            front_n = p.front_stiffness * (STEER_RAD * p.inverse_ratio - (side + a * yaw) / v)
            rear_n = -p.rear_stiffness * (side - b * yaw) / v
            rates = ((front + rear) * p.inverse_mass - v * yaw, (a * front - b * rear) * p.inverse_inertia)
            front, rear = front + dt_s * (front_n - front) * v / length_m, rear + dt_s * (rear_n - rear) * v / length_m
            side, yaw = side + dt_s * rates[0], yaw + dt_s * rates[1]
        found.append((side, yaw))
    return found


@pytest.mark.parametrize("speed", [3.0, 8.0, 20.0])
@pytest.mark.parametrize("length_m", [0.1, 0.5, 2.0])
def test_it_solves_the_equations(length_m: float, speed: float) -> None:
    """Within 1.5 % of the largest yaw rate and side speed, at the speed that the car itself has."""
    p, motions = stepped(length_m, speed, 100)
    exact = integrated(p, length_m, [motion.speed_mps for motion in motions])
    for i, name in enumerate(("side_speed_mps", "yaw_rate_radps")):
        most = max(abs(one[i]) for one in exact)
        miss = max(abs(getattr(motion, name) - one[i]) for motion, one in zip(motions, exact, strict=True))
        assert miss < 0.015 * most


def test_without_a_length_the_step_is_the_plain_one() -> None:
    """The limit: what is left of it in a length of 0.01 mm is the scheme's error of stiff equations."""
    plain, tiny = stepped(0.0, 8.0, 100)[1], stepped(1e-5, 8.0, 100)[1]
    for one, other in zip(plain, tiny, strict=True):
        assert other.yaw_rate_radps == pytest.approx(one.yaw_rate_radps, abs=2e-4)


@pytest.mark.parametrize("length_m", [0.02, 0.3, 1.0])
def test_hard_driving_is_as_accurate_as_without(length_m: float) -> None:
    """Tyres at their limit: against steps of 1/20 the error is that of the car whose tyres do not relax."""

    def missed(length_m: float) -> float:
        effect = catalogue()["tyre_relaxation"]
        assert effect.port is Port.BODY and make_effect(effect, {"length_m": length_m})
        yaws = []
        for substeps in (1, 20):
            body = car("physics", {}, ((effect, {"length_m": length_m}),), substeps=substeps)
            asked = drive(body, lambda t: command(0.25, REST, 4.0 * math.sin(4.0 * t)), 2.0, start=Start(speed_mps=9.0))
            yaws.append([out.motion.yaw_rate_radps for out in asked])
        return max(abs(a - b) for a, b in zip(*yaws, strict=True))

    assert missed(length_m) < 1.5 * missed(0.0) + 1e-4
