"""Noise, bias and latency of what is measured."""

from __future__ import annotations

import math
import statistics

import pytest

from tests.plant.drives import DT_S, REST, car, command, drive
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import Actuation, Motion
from tunefree_hil.plant.measurement.sensors import NOISY, WIDTH, SensorInput, SensorParams, noise_table, sensors
from tunefree_hil.plant.types import Driver

SEEN = SensorInput(
    Motion(1.0, 2.0, 4.0, 5.0, 0.1, 0.2, 0.7, 0.8, 0.6, 14.0, 15.0, 16.0, 17.0),
    Actuation(0.21, 0.16, 0.4, 4.0),
    command(0.22, 0.17, 0.5),
    Driver(0.151, 0.152, 0.3),
)


def measure(params: SensorParams) -> dict[str, float]:
    """All fields of one measurement by their names in NOISY."""
    block = sensors(params)
    _, seen = block.step(params, block.init(params, DT_S), SEEN, DT_S)
    return {
        f"{group}.{field}": value
        for group, record in (("report", seen.report), ("ins", seen.ins))
        for field, value in record._asdict().items()
    }


def test_without_noise_the_truth_is_said() -> None:
    seen = measure(SensorParams(noise_table({}, {}, 0, 0)))
    wanted = {
        "report.throttle_input_frac": 0.151, "report.throttle_command_frac": 0.22, "report.throttle_frac": 0.21,
        "report.brake_input_frac": 0.152, "report.brake_command_frac": 0.17, "report.brake_frac": 0.16,
        "report.steer_command_rad": 0.5, "report.steer_rad": 0.4, "report.speed_mps": 5.0,
        "report.wheel_fl_radps": 14.0, "report.wheel_fr_radps": 15.0, "report.wheel_rl_radps": 16.0,
        "report.wheel_rr_radps": 17.0, "report.accel_mps2": 0.7, "report.lateral_accel_mps2": 0.8,
        "report.yaw_rate_radps": 0.2, "report.gear": 4.0, "report.steer_torque_nm": 0.3,
        "ins.x_m": 1.0, "ins.y_m": 2.0, "ins.speed_mps": 5.0, "ins.accel_mps2": 0.6, "ins.yaw_rate_radps": 0.2,
    }  # fmt: skip
    assert {key: seen[key] for key in wanted} == wanted
    assert seen["ins.heading_rad"] == pytest.approx(4.0 - 2.0 * math.pi)
    assert math.isnan(seen["report.accel_command_mps2"]) and math.isnan(seen["report.steer_torque_command_nm"])


@pytest.mark.parametrize("name", NOISY)
def test_each_field_has_its_own_column(name: str) -> None:
    clean = measure(SensorParams(noise_table({}, {}, 0, 0)))
    offset = measure(SensorParams(noise_table({}, {name: 0.125}, 0, 0)))
    changed = {key for key in clean if offset[key] != clean[key] and not math.isnan(clean[key])}
    assert changed == {name} and offset[name] - clean[name] == pytest.approx(0.125)


def test_noise_has_its_deviation_and_its_seed() -> None:
    rows = noise_table({"ins.x_m": 0.5, "report.speed_mps": 0.1}, {"ins.x_m": 3.0}, 3999, 1)
    column = rows[NOISY.index("ins.x_m") :: WIDTH]
    assert len(column) == 4000
    assert statistics.stdev(column) == pytest.approx(0.5, rel=0.05)
    assert statistics.mean(column) == pytest.approx(3.0, abs=0.05)
    alone = noise_table({"ins.x_m": 0.5}, {"ins.x_m": 3.0}, 3999, 1)
    assert alone[NOISY.index("ins.x_m") :: WIDTH] == column, "a field's stream is its own"
    assert noise_table({"ins.x_m": 0.5}, {}, 50, 1) == noise_table({"ins.x_m": 0.5}, {}, 50, 1)
    assert noise_table({"ins.x_m": 0.5}, {}, 50, 1) != noise_table({"ins.x_m": 0.5}, {}, 50, 2)


def test_rows_follow_the_ticks_and_begin_again() -> None:
    rows = noise_table({"report.speed_mps": 1.0}, {}, 3, 5)
    outputs = drive(car("physics"), lambda t: command(), 0.09, noise=rows)
    seen = [out.measurement.report.speed_mps - out.motion.speed_mps for out in outputs]
    column = list(rows[NOISY.index("report.speed_mps") :: WIDTH])
    assert seen == pytest.approx((column * 3)[: len(seen)])


def test_unknown_field() -> None:
    with pytest.raises(InputError) as caught:
        noise_table({"report.gear": 1.0}, {}, 1, 1)
    assert "report.gear" in str(caught.value)


def test_the_ins_is_late_also_at_the_start() -> None:
    start = Start(3.0, -1.0, 2.5, 8.0)
    outputs = drive(car("physics", ins_latency_s=0.03), lambda t: command(0.3, REST, 0.5), 0.5, start=start)
    for k in range(3, len(outputs)):
        assert outputs[k].measurement.ins.x_m == outputs[k - 3].motion.x_m
        assert outputs[k].measurement.ins.speed_mps == outputs[k - 3].motion.speed_mps
    first = outputs[0].measurement.ins
    assert first.x_m == pytest.approx(3.0 - 0.24 * math.cos(2.5)) and first.y_m == pytest.approx(
        -1.0 - 0.24 * math.sin(2.5)
    )
    assert first.speed_mps == 8.0


def test_ins_point_and_kind_of_acceleration() -> None:
    seen = measure(SensorParams(noise_table({}, {}, 0, 0), 1.5, 1.0))
    assert seen["ins.x_m"] == pytest.approx(1.0 + 1.5 * math.cos(4.0))
    assert seen["ins.y_m"] == pytest.approx(2.0 + 1.5 * math.sin(4.0))
    assert seen["ins.accel_mps2"] == 0.7
