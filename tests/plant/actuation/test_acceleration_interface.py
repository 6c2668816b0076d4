"""A car that is asked for an acceleration drives with it, through the channel's dead time and lag, and nothing else."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import run
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command, Disturbance
from tunefree_hil.plant.actuation.acceleration_interface import FULL_MPS2, linear, pedals_of
from tunefree_hil.plant.actuation.actuators import ActuatorParams, actuator
from tunefree_hil.plant.single_track import PLANT
from tunefree_hil.plant.types import BodyInput, BodyOutput, Driver
from tunefree_hil.plant.vehicle import assemble, first_output, for_episode

DT_S, REST = 0.01, 0.1
STEER = ActuatorParams()


def driven(accel: ActuatorParams, asked: list[float], grade_rad: float = 0.0) -> list[BodyOutput]:
    channels = {"accel": accel, "steer": STEER}
    body = assemble(PLANT, linear(1500.0, REST) | {"mass_kg": 1500.0}, channels, rest_frac=(REST, REST), dt_s=DT_S)
    body = for_episode(body, Start(speed_mps=15.0))
    state, _ = first_output(body, DT_S)
    found = []
    for one in asked:
        x = BodyInput(Command(NAN, NAN, 0.0, GEAR_DRIVE, one, NAN), Driver(REST, REST), Disturbance(grade_rad, 1.0))
        state, out = body.block.step(body.block.params, state, x, DT_S)
        found.append(out)
    return found


@given(st.floats(-9.0, 9.0), st.floats(0.0, 0.3))
def test_one_pedal_at_most_is_pressed_and_it_is_worth_the_acceleration(accel: float, rest: float) -> None:
    throttle, brake = pedals_of(accel, rest)
    assert min(throttle, brake) == rest
    assert (throttle - brake) * FULL_MPS2 == pytest.approx(accel, abs=1e-9)


def test_the_car_drives_with_what_the_channel_makes_of_the_command() -> None:
    accel = ActuatorParams(dead_time_s=0.05, lag_s=0.2, gain=1.1, offset=-0.05, initial=0.0)
    asked = [1.2] * 150 + [-2.0] * 150 + [0.3] * 100  # through 0 both ways
    outs = driven(accel, asked)
    wanted = run(actuator(accel), asked, DT_S)
    missed = [abs(out.motion.speed_rate_mps2 - one) for out, one in zip(outs, wanted, strict=True)]
    assert max(missed) < 0.005
    assert outs[-1].measurement.report.accel_command_mps2 == 0.3


def test_a_slope_comes_on_top_and_steering_passes() -> None:
    level, uphill = driven(ActuatorParams(), [0.5] * 50), driven(ActuatorParams(), [0.5] * 50, 0.05)
    assert uphill[-1].motion.speed_rate_mps2 == pytest.approx(level[-1].motion.speed_rate_mps2 - 0.49, abs=0.01)
    assert level[-1].actuation.steer_rad == 0.0


def test_it_stands_where_it_was_braked_to() -> None:
    outs = driven(ActuatorParams(), [-5.0] * 400)
    assert outs[-1].motion.speed_mps == 0.0


def test_channels_that_make_no_car_are_refused() -> None:
    with pytest.raises(InputError, match="the actuators are accel, throttle"):
        assemble(PLANT, {}, {"accel": STEER, "throttle": STEER})
    assemble(PLANT, {}, {"accel": STEER, "steer": STEER, "steer_torque": STEER})
