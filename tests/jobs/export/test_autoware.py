"""Autoware's files, read back, and the pedal tables by Autoware's rules."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.jobs.export.made_values import PREVIEW, make_values, texts
from tests.jobs.export.read_back import read_csv, read_yaml
from tunefree_hil.control.lateral.lqr import LATERAL_RATIO, SCHEDULE_MPS
from tunefree_hil.control.parameters import round32
from tunefree_hil.jobs.export.autoware import converter_keys, export_autoware
from tunefree_hil.jobs.export.pedal_maps import PedalMap
from tunefree_hil.jobs.export.remarks import RemarkKind
from tunefree_hil.jobs.export.values import ExportValues


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> ExportValues:
    return make_values(tmp_path_factory.mktemp("bench"), lqr__q1=round32(0.0731), speed__kp_high=round32(0.77))


def test_gains_and_actuators_come_back(made: ExportValues) -> None:
    files = texts(export_autoware(made))
    mpc, pid = read_yaml(files["mpc.param.yaml"]), read_yaml(files["pid.param.yaml"])
    assert round32(mpc["mpc_weight_lat_error"]) == made.values["lqr.q1"]
    assert round32(mpc["mpc_weight_heading_error"]) == made.values["lqr.q3"]
    assert mpc["input_delay"] == pytest.approx(0.12) and mpc["vehicle_model_steer_tau"] == pytest.approx(0.0773)
    assert (round32(pid["kp"]), round32(pid["ki"])) == (made.values["speed.kp_high"], made.values["speed.ki_high"])
    assert pid["max_out"] == pytest.approx(2.0 * 0.77 + 0.3) and pid["min_out"] == -pid["max_out"]
    assert (pid["max_acc"], pid["min_acc"], pid["enable_slope_compensation"]) == (2.0, -6.0, False)
    info = read_yaml(files["vehicle_info.param.yaml"])
    assert info == {"wheel_radius": 0.335, "wheel_base": 2.8448, "max_steer_angle": pytest.approx(8.20305 / 16.0)}
    converter = read_yaml(files["raw_vehicle_cmd_converter.param.yaml"])
    assert converter["convert_steer_cmd_method"] == "vgr" and converter["vgr_coef_a"] == 16.0
    assert converter["csv_path_accel_map"] == "accel_map.csv" and converter["max_steer"] == 8.20305


def test_no_number_is_an_integer_or_has_an_exponent(made: ExportValues) -> None:
    """ROS 2 refuses an integer for a double, and YAML 1.1 reads 1e-06 as text."""
    tiny = made._replace(values={**made.values, "speed.ki_high": round32(1e-6)})
    for name, text in texts(export_autoware(tiny)).items():
        values = [line.partition(": ")[2] for line in text.splitlines() if name.endswith(".yaml") and line[0] == " "]
        assert all("." in one and "e" not in one for one in values if one[:1].isdigit())
    assert "ki: 0.000001\n" in texts(export_autoware(tiny))["pid.param.yaml"]


def test_the_scheduler_is_a_weight_over_the_square_of_the_speed(made: ExportValues) -> None:
    weight = read_yaml(texts(export_autoware(made))["mpc.param.yaml"])["mpc_weight_steering_input_squared_vel"]
    squares = np.square(SCHEDULE_MPS)
    wanted = np.linalg.lstsq(squares[:, None], 1.0 / np.array(LATERAL_RATIO) - 1.0, rcond=None)[0][0]
    assert weight == pytest.approx(wanted, rel=1e-6)
    assert np.all(np.abs((1.0 + weight * squares) * np.array(LATERAL_RATIO) - 1.0) < 0.7)


def test_the_tables_keep_to_what_autoware_checks(made: ExportValues) -> None:
    files = texts(export_autoware(made))
    for name, sign in (("accel_map.csv", 1.0), ("brake_map.csv", -1.0)):
        speeds, pedals, rows = read_csv(files[name])
        assert len(speeds) == len(rows[0]) and all(len(row) == len(speeds) for row in rows)
        assert pedals[0] == 0.0 and np.all(np.diff(pedals) > 0.0) and np.all(np.diff(speeds) > 0.0)
        assert np.all(sign * np.diff(rows, axis=0) > 0.0), "strictly, at every speed"


def test_gains_of_preview_parts_are_warned_of(tmp_path: Path) -> None:
    source = make_values(tmp_path, PREVIEW)
    export = export_autoware(source)
    differs = {remark.subject for remark in export.remarks if remark.kind is RemarkKind.DIFFERS}
    assert {"lateral = lqr_preview", "longitudinal = pid_preview", "station.kp", "MRAC"} <= differs


def test_weights_of_our_own_mpc_go_to_their_names(made: ExportValues) -> None:
    values = {**made.values, "mpc.q_lateral": 0.25, "mpc.q_heading": 2.0, "mpc.r_steer": 0.5, "mpc.r_steer_rate": 0.125}
    other = made._replace(values=values, parts=made.parts._replace(lateral="mpc", longitudinal="mpc"))
    export = export_autoware(other)
    assert "pid.param.yaml" not in texts(export)
    mpc = read_yaml(texts(export)["mpc.param.yaml"])
    assert (mpc["mpc_weight_lat_error"], mpc["mpc_weight_heading_error"]) == (0.25, 2.0)
    assert (mpc["mpc_weight_steering_input"], mpc["mpc_weight_steer_rate"]) == (0.5, 0.125)


def test_an_unknown_lateral_part_leaves_the_delays_only(made: ExportValues) -> None:
    export = export_autoware(made._replace(parts=made.parts._replace(lateral="pursuit")))
    mpc = read_yaml(texts(export)["mpc.param.yaml"])
    assert "input_delay" in mpc and not any(name.startswith("mpc_weight") for name in mpc)


def test_the_largest_pedals_count_from_rest(made: ExportValues) -> None:
    """The limits of a vehicle folder are whole duties, Autoware's pedals begin at rest."""
    rest_frac = made.vehicle.rest_pedal_frac
    throttle, brake = (PedalMap(1.0, np.array([0.0, 1.0]), np.zeros(1), np.zeros((2, 1))) for _ in range(2))
    keys = converter_keys(made, throttle, brake)
    assert rest_frac > 0.0
    assert keys["max_throttle"] == pytest.approx(made.vehicle.throttle_limit_frac - rest_frac)
    assert keys["max_brake"] == pytest.approx(made.vehicle.brake_limit_frac - rest_frac)
