"""The loops over a drive are halves of a vehicle's tick, and their rows have every field of a record in its place."""

from __future__ import annotations

import numpy as np

from tests.effects.shared import EFFECTS, strong, weave
from tests.plant.drives import DT_S, car
from tunefree_hil.base.contracts import BodyChange, make_effect
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import Actuation, Disturbance, Ins, Motion, Report
from tunefree_hil.gap.model.kernels import (
    N_INPUTS,
    N_OUTPUTS,
    N_SIMULATED,
    SIMULATED_FIELDS,
    InputRow,
    OutputRow,
    SimulatedRow,
    is_pinned,
    make_actuator_loop,
    make_vehicle_loop,
    pack_output,
    pack_simulated,
    unpack_command,
    unpack_motion,
    unpack_output,
)
from tunefree_hil.plant.ports import Effects
from tunefree_hil.plant.single_track import PLANT
from tunefree_hil.plant.types import NO_DRIVER, BodyInput
from tunefree_hil.plant.vehicle import BodyState, for_episode


def test_an_input_row_is_read_by_its_fields() -> None:
    row = InputRow(*(float(i + 1) for i in range(N_INPUTS)))
    rows, start = [0.0] * N_INPUTS + list(row), N_INPUTS
    commands = (row.throttle_command_frac, row.brake_command_frac, row.steer_command_rad, row.gear)
    assert unpack_command(rows, start)[:4] == commands
    assert unpack_output(rows, start) == (row.throttle_frac, row.brake_frac, row.steer_rad, row.gear)
    motion = unpack_motion(rows, start)
    for name in ("speed_mps", "yaw_rate_radps", "side_speed_mps", "speed_rate_mps2"):
        assert getattr(motion, name) == getattr(row, name), name
    for pinned in (0.0, 1.0):
        assert is_pinned(list(row._replace(is_pinned=pinned)), 0) == (pinned > 0.0)
    assert N_INPUTS == 3 + 4 + 4 + 1, "a field that is added has to be read as well"


def test_an_output_row_has_reported_and_true_outputs() -> None:
    rows = [0.0] * N_OUTPUTS
    assert pack_output(rows, 0, Report(throttle_frac=1.0, brake_frac=2.0, steer_rad=3.0), Actuation(4.0, 5.0, 6.0, 7.0))
    row = OutputRow(*rows)
    assert (row.reported_throttle_frac, row.reported_brake_frac, row.reported_steer_rad) == (1.0, 2.0, 3.0)
    assert (row.throttle_frac, row.brake_frac, row.steer_rad) == (4.0, 5.0, 6.0)


def test_a_simulated_row_has_each_value_under_its_name() -> None:
    motion = Motion(*(float(i + 1) for i in range(len(Motion._fields))))
    report = Report(*(100.0 + i for i in range(len(Report._fields))))
    ins = Ins(*(200.0 + i for i in range(len(Ins._fields))))
    rows = [0.0] * N_SIMULATED
    assert pack_simulated(rows, 0, motion, report, ins) == N_SIMULATED == len(SIMULATED_FIELDS)
    row = SimulatedRow(*rows)
    for name, value in row._asdict().items():
        if name.startswith("ins_"):
            assert value == getattr(ins, name.removeprefix("ins_")), name
        elif name in ("speed_mps", "yaw_rate_radps", "accel_mps2", "lateral_accel_mps2"):
            assert value == getattr(report, name), name
    assert row.rate_mps2 == motion.speed_rate_mps2
    assert row.wheels_radps == 0.5 * (report.wheel_rl_radps + report.wheel_rr_radps)


TICKS = 150
IN_SERIES = (  # at every port at which an effect may be, two where their order shows
    "throttle_lag", "brake_dead_time", "steer_saturation", "steer_lag", "throttle_rate_limit", "steer_rate_limit",
    "throttle_dead_band", "brake_gain", "steer_gain", "steer_backlash", "yaw_rate_filter", "report_latency",
    "steer_report_offset", "ins_latency",
)  # fmt: skip


def made_input_rows() -> np.ndarray:
    """Commands of a drive, (TICKS + 1, N_INPUTS); nothing is measured."""
    rows = np.zeros((TICKS + 1, N_INPUTS))
    for k in range(TICKS):
        command = weave(k * DT_S)
        given = (command.throttle_frac, command.brake_frac, command.steer_rad)
        row = InputRow(*given, 0.0, 0.0, 0.0, command.gear, 0.0, 0.0, 0.0, 0.0, 0.0)
        rows[k + 1] = row
    return rows


def test_the_two_loops_together_are_the_vehicle() -> None:
    chosen = tuple((EFFECTS[name], strong(name)) for name in IN_SERIES)
    body = for_episode(car("physics", effects=chosen), Start(speed_mps=6.0))
    effects: Effects = [(effect.port, make_effect(effect, values, rest=0.0)) for effect, values in chosen]
    params, rows = body.block.params, made_input_rows()
    chassis = PLANT.make({}, BodyChange())
    outputs, simulated = np.zeros((TICKS + 1) * N_OUTPUTS), np.zeros((TICKS + 1) * N_SIMULATED)
    state: BodyState = body.block.init(params, DT_S)
    make_actuator_loop(effects)(params, state, rows.ravel(), outputs, DT_S)
    outputs = outputs.reshape(-1, N_OUTPUTS)
    rows[:, 3:6] = outputs[:, 3:]
    make_vehicle_loop(effects, chassis.step, PLANT.observe)(
        params, body.block.init(params, DT_S), rows.ravel(), simulated, DT_S
    )
    state = body.block.init(params, DT_S)
    for k, row in enumerate(simulated.reshape(-1, N_SIMULATED)[1:], 1):
        x = BodyInput(weave((k - 1) * DT_S), NO_DRIVER, Disturbance())
        state, y = body.block.step(params, state, x, DT_S)
        expected = [0.0] * N_SIMULATED
        pack_simulated(expected, 0, y.motion, y.measurement.report, y.measurement.ins)
        assert list(row) == expected, k
        expected = [0.0] * N_OUTPUTS
        pack_output(expected, 0, y.measurement.report, y.actuation)
        assert list(outputs[k]) == expected, k
