"""Rows of the compiled loops: every field of a record in its place."""

from __future__ import annotations

from tunefree_hil.base.records import Actuation, Ins, Motion, Report
from tunefree_hil.gap.model.kernels import (
    N_INPUTS,
    N_OUTPUTS,
    N_SIMULATED,
    SIMULATED_FIELDS,
    InputRow,
    OutputRow,
    SimulatedRow,
    is_pinned,
    pack_output,
    pack_simulated,
    unpack_command,
    unpack_motion,
    unpack_output,
)


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
