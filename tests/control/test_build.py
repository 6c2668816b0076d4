"""From parameter vector to driving controller: every part of every folder, a user's own, mistakes, cost."""

from __future__ import annotations

import math
import time

import pytest

from tunefree_hil.base import parts
from tunefree_hil.base.errors import InputError
from tunefree_hil.control.build import PartNames, build, identified_of_data_sheet, own_values
from tunefree_hil.control.cascade import ControllerInput
from tunefree_hil.control.contract import VehicleConstants
from tunefree_hil.control.parameters import BASELINES, study_values
from tunefree_hil.control.steering_map import data_sheet_map

DT_S = 0.01
MKZ = VehicleConstants()


def bend(station):
    return 0.06 * math.sin(station / 8.0) if station > 10.0 else 0.0


def stop_at_the_end(t):
    return min(5.0, 1.5 * t) if t < 10.0 else max(0.0, 5.0 - 1.0 * (t - 10.0))


def drive(kit, block, ticks, start):
    """(decisions, seconds a tick) of a drive with perfect actuators."""
    state, car, decisions, spent = block.init(block.params, DT_S), start, [], 0.0
    for k in range(ticks):
        sight = ControllerInput(k, car.measurement())
        began = time.perf_counter()
        state, decision = block.step(block.params, state, sight, DT_S)
        spent += time.perf_counter() - began
        decisions.append(decision)
        car = car.moved(decision.command.steer_rad / 16.0, decision.command.accel_mps2)
    return decisions, spent / ticks


@pytest.mark.parametrize("name", list(BASELINES))
def test_baselines_drive(kit, name):
    course = kit.course(17.0, stop_at_the_end, bend)
    block = build(BASELINES[name], MKZ, kit.linear_map(), course)
    decisions, cost_s = drive(kit, block, 1700, kit.car(0.0, 0.2, 0.0, 0.0))
    print(f"{name}: {1e6 * cost_s:.0f} us a tick")
    assert all(decision.error_code == 0.0 for decision in decisions)
    assert max(abs(decision.tracking.lateral_error_m) for decision in decisions) < 0.52
    last = decisions[-1].tracking
    assert last.ref_speed_mps == 0.0 and last.speed_error_mps == pytest.approx(0.0, abs=1e-6)
    assert abs(last.station_error_m) < 0.5
    assert decisions[-1].command.brake_frac > 0.15
    if "look_ahead" not in name:
        assert not any(decision.tracking.replan for decision in decisions)
        assert max(abs(decision.tracking.lateral_error_m) for decision in decisions[600:]) < 0.2


@pytest.mark.parametrize(
    ("lateral", "inner"), [("lqr_preview", "mrac_robust"), ("lqr_preview", "mrac"), ("lqr", "mrac")]
)
def test_the_bound_of_the_steering_has_the_slip_that_the_lateral_part_knows(kit, lateral, inner):
    names = PartNames(lateral=lateral, inner=inner)
    values = {**study_values(), **BASELINES["mrac_on"], **own_values(names)}
    steering = data_sheet_map(MKZ)._replace(understeer_s2pm=0.004)
    course = kit.course(6.0, lambda t: 4.0, bend)
    known = identified_of_data_sheet(MKZ)._replace(steering=steering)
    params = build(values, MKZ, kit.linear_map(), course, names=names, identified=known).params
    slip_rad = 0.004 * MKZ.lateral_accel_mps2 if lateral == "lqr_preview" else 0.0
    assert params.limits.bound.slip_rad == params.inner.bound.slip_rad == pytest.approx(slip_rad)


def test_every_part_drives_within_limits_and_says_the_same_twice(kit):
    course = kit.course(6.0, lambda t: 4.0, bend)
    for lateral in parts.names("tunefree_hil.control.lateral"):
        for longitudinal in parts.names("tunefree_hil.control.longitudinal"):
            for inner in parts.names("tunefree_hil.control.inner"):
                names = PartNames(lateral, longitudinal, inner)
                runs = []
                for _ in range(2):
                    values = study_values() | own_values(names)
                    block = build(values, MKZ, kit.linear_map(), course, names=names)
                    runs.append(drive(kit, block, 600, kit.car(0.0, -0.2, 0.05, 3.0))[0])
                assert runs[0] == runs[1]
                for command in (decision.command for decision in runs[0]):
                    assert 0.15 <= command.throttle_frac <= 0.8
                    assert 0.15 <= command.brake_frac <= 0.5
                    assert abs(command.steer_rad) <= MKZ.steer_limit_rad
                    assert command.gear == 4.0


def test_parameters_reach_their_parts(kit):
    course = kit.course(3.0, lambda t: 4.0)
    base = build(study_values(), MKZ, kit.linear_map(), course)
    for name, value in study_values().items():
        other = 1.0 - value if name in ("riccati", "mrac.enable") else value * 1.1 + 0.01
        changed = build({**study_values(), name: other}, MKZ, kit.linear_map(), course)
        assert changed.params != base.params, name
    assert {tunable.name for tunable in base.tunables} == set(study_values())


OWN = """
from typing import NamedTuple
from tunefree_hil.base.contracts import Block, Tunable

class Params(NamedTuple):
    gain: float = 1.0

def init(params, dt_s):
    return 0.0

def step(params, state, x, dt_s):
    tracking, measurement = x
    return state, -params.gain * (tracking.lateral_error_m + 2.0 * tracking.heading_error_rad)

CONTROLLER = Block(init, step, Params(), (Tunable("mine.gain", "rad/m", 0.1, 10.0),))
"""


def test_a_users_own_controller(kit, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(OWN)
    names = PartNames(lateral=f"{file}:CONTROLLER")
    assert own_values(names) == {"mine.gain": 1.0}, "what its params say"
    course = kit.course(8.0, lambda t: 4.0)
    block = build({**study_values(), "mine.gain": 6.0}, MKZ, kit.linear_map(), course, names=names)
    decisions, _ = drive(kit, block, 700, kit.car(0.0, 0.3, 0.0, 4.0))
    assert decisions[0].steer_demand_rad == pytest.approx(-6.0 * 0.3)
    assert abs(decisions[-1].tracking.lateral_error_m) < 0.02
    with pytest.raises(InputError, match=r"missing: mine\.gain"):
        build(study_values(), MKZ, kit.linear_map(), course, names=names)
    file.write_text(OWN.replace("gain: float = 1.0", "strength: float = 1.0"))
    with pytest.raises(InputError, match=r"without a field.*mine\.gain"):
        build({**study_values(), "mine.gain": 6.0}, MKZ, kit.linear_map(), course, names=names)


def test_unknown_part_names_the_parts_there_are(kit):
    with pytest.raises(InputError, match="there are lqr"):
        build(study_values(), MKZ, kit.linear_map(), kit.course(1.0, lambda t: 1.0), names=PartNames(lateral="lqg"))
