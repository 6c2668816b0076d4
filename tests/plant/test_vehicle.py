"""The assembled vehicle: order of a tick, tick 0, episodes, payload; and what a kind of plant must keep."""

from __future__ import annotations

import math

import pytest

from tests.plant.drives import CHANNELS, DT_S, PLANTS, REST, car, command, drive
from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_PARK, Disturbance
from tunefree_hil.plant import single_track
from tunefree_hil.plant.types import BodyInput, Driver, laden
from tunefree_hil.plant.vehicle import assemble, first_output, for_episode, steady_accel

KINDS = sorted(PLANTS)
START = Start(1.0, 2.0, 0.5, 6.0)


@pytest.mark.parametrize("kind", KINDS)
def test_tick_0(kind: str) -> None:
    _, out = first_output(for_episode(car(kind), START), DT_S)
    assert out.motion[:6] == (1.0, 2.0, 0.5, 6.0, 0.0, 0.0)
    assert out.actuation == (REST, REST, 0.0, 4.0)
    assert out.measurement.report.speed_mps == 6.0 and out.measurement.ins.heading_rad == 0.5
    assert out.measurement.report.wheel_fl_radps == pytest.approx(6.0 / 0.335)


@pytest.mark.parametrize("kind", KINDS)
def test_the_measurement_is_of_the_state_after_the_tick(kind: str) -> None:
    for out in drive(car(kind), lambda t: command(0.3, REST, 1.0), 0.5, start=START)[1:]:
        report, motion = out.measurement.report, out.motion
        assert (report.speed_mps, report.yaw_rate_radps) == (motion.speed_mps, motion.yaw_rate_radps)
        assert (report.throttle_frac, report.steer_rad) == (out.actuation.throttle_frac, out.actuation.steer_rad)
        assert (report.throttle_command_frac, report.steer_command_rad) == (0.3, 1.0)
        assert (out.measurement.ins.x_m, out.measurement.ins.y_m) == (motion.x_m, motion.y_m)


@pytest.mark.parametrize("kind", KINDS)
def test_it_moves_from_the_first_tick(kind: str) -> None:
    out = drive(car(kind), lambda t: command(), DT_S, start=START)[1]
    assert out.motion.x_m == pytest.approx(1.0 + 0.06 * math.cos(0.5), rel=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_the_driver_shows_in_the_report_only(kind: str) -> None:
    body = for_episode(car(kind), START)
    outs = []
    for driver in (Driver(), Driver(0.2, 0.3, 1.5)):
        state, _ = first_output(body, DT_S)
        x = BodyInput(command(), driver, Disturbance())
        outs.append(body.block.step(body.block.params, state, x, DT_S)[1])
    assert outs[0].motion == outs[1].motion
    report = outs[1].measurement.report
    assert (report.throttle_input_frac, report.brake_input_frac, report.steer_torque_nm) == (0.2, 0.3, 1.5)


@pytest.mark.parametrize("kind", KINDS)
def test_episodes_do_not_know_of_each_other(kind: str) -> None:
    body = car(kind)

    def once() -> list[float]:
        return list(drive(body, lambda t: command(0.3, REST, 2.0), 0.4, start=START)[-1].motion)

    first = once()
    drive(body, lambda t: command(REST, 0.3, -3.0), 0.4, start=Start(speed_mps=10.0))
    assert once() == first


@pytest.mark.parametrize("kind", KINDS)
def test_outputs_are_plain_floats(kind: str) -> None:
    out = drive(car(kind, ins_latency_s=0.02), lambda t: command(0.3, 0.2, 1.0), 0.1, start=START)[-1]
    for record in (out.actuation, out.motion, out.measurement.report, out.measurement.ins):
        assert {type(value) for value in record} == {float}


@pytest.mark.parametrize("kind", KINDS)
def test_park_holds(kind: str) -> None:
    out = drive(car(kind), lambda t: command(0.5, REST, 0.0, GEAR_PARK), 1.0, road=Disturbance(-0.1, 1.0))[-1]
    assert out.motion.speed_mps == 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_payload_scales_braking(kind: str) -> None:
    plant = PLANTS[kind]
    x = BodyChange(payload_kg=400.0)
    light, heavy = plant.make({}, BodyChange()), plant.make({}, x)
    masses = light.params.constants.mass_kg, heavy.params.constants.mass_kg
    assert masses[1] - masses[0] == 400.0
    assert heavy.params.constants.front_axle_m == light.params.constants.front_axle_m


def test_laden_by_parallel_axes() -> None:
    both = BodyChange(300.0, 300.0 * 0.8, 300.0 * 0.64)
    car_, base = laden(1700.0, 2.8, 1.3, 3000.0, both), laden(1700.0, 2.8, 1.3, 3000.0, BodyChange())
    assert base == (1700.0, 1.3, 2.8 - 1.3, 3000.0)
    assert car_.mass_kg == 2000.0 and car_.front_axle_m == pytest.approx(1.3 - 0.12)
    assert car_.yaw_inertia_kgm2 == pytest.approx(3000.0 + 1700.0 * 0.12**2 + 300.0 * 0.68**2)
    with pytest.raises(InputError):
        laden(1700.0, 2.8, 1.3, 3000.0, BodyChange(2000.0, 2000.0 * 4.0, 2000.0 * 16.0))
    with pytest.raises(InputError):
        laden(1700.0, 2.8, 1.3, 3000.0, BodyChange(-1700.0))


def test_steady_accel_is_what_a_drive_shows() -> None:
    wanted = steady_accel(single_track.PLANT, {}, 8.0, 0.3, REST)
    outputs = drive(car("physics"), lambda t: command(0.3), 0.05, start=Start(speed_mps=8.0))
    shown = [out.motion.speed_rate_mps2 for out in outputs if out.actuation.throttle_frac > 0.29]
    assert shown[0] == pytest.approx(wanted, rel=0.01)


def test_missing_channels() -> None:
    with pytest.raises(InputError) as caught:
        assemble(single_track.PLANT, {}, {"steer": CHANNELS["steer"]})
    assert "throttle" in caught.value.hint
