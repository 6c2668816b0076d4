"""Apollo's files, read back: every number to binary32, the table by Apollo's lookup, what differs said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.jobs.export.made_values import PREVIEW, make_values, texts
from tests.jobs.export.read_back import ApolloTable, Fields, read_text_proto
from tunefree_hil.base.open_loop_map import Triples
from tunefree_hil.control.calibration_map import lookup
from tunefree_hil.control.contract import Settings
from tunefree_hil.control.lateral.lqr import gain_rows
from tunefree_hil.control.mrac_model import second_order_pb
from tunefree_hil.control.parameters import NAMES, round32
from tunefree_hil.jobs.export.apollo import capped_share, export_apollo, needed_rounds
from tunefree_hil.jobs.export.remarks import Export, RemarkKind
from tunefree_hil.jobs.export.values import ExportValues

TOGETHER, TABLE = "apollo_6_7/control_conf.pb.txt", "apollo_8/control_task_base/conf/calibration_table.pb.txt"
LATERAL = "apollo_8/lat_based_lqr_controller/conf/controller_conf.pb.txt"
LONGITUDINAL = "apollo_8/lon_based_pid_controller/conf/controller_conf.pb.txt"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> ExportValues:
    return make_values(tmp_path_factory.mktemp("bench"))


def lateral_of(export: Export) -> Fields:
    return read_text_proto(texts(export)[TOGETHER])["lat_controller_conf"][0]


def subjects(export: Export, kind: RemarkKind) -> dict[str, str]:
    return {remark.subject: remark.text for remark in export.remarks if remark.kind is kind}


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(numbers=st.lists(st.floats(1e-4, 10.0), min_size=13, max_size=13))
def test_every_gain_comes_back_to_binary32(made: ExportValues, numbers: list[float]) -> None:
    names = [name for name in NAMES if name not in ("mrac.enable", "riccati", "look_ahead_m")]
    values = {**made.values, **{name: round32(x) for name, x in zip(names, numbers, strict=True)}}
    one_point = Triples([1.0], [0.5], [0.3])
    files = texts(export_apollo(made._replace(values=values, triples=one_point)))
    for lat, lon in (
        (
            read_text_proto(files[TOGETHER])["lat_controller_conf"][0],
            read_text_proto(files[TOGETHER])["lon_controller_conf"][0],
        ),
        (read_text_proto(files[LATERAL]), read_text_proto(files[LONGITUDINAL])),
    ):
        mrac = lat["steer_mrac_conf"][0]
        found = {
            "mrac.t_ref_s": mrac["reference_time_constant"][0],
            "mrac.p": mrac["adaption_matrix_p"][0],
            "mrac.clamp_s": mrac["clamping_time_constant"][0],
            "mrac.gamma": mrac["adaption_state_gain"][0],
            **{f"lqr.q{i + 1}": value for i, value in enumerate(lat["matrix_q"])},
            "station.kp": lon["station_pid_conf"][0]["kp"][0],
            "speed.kp_low": lon["low_speed_pid_conf"][0]["kp"][0],
            "speed.ki_low": lon["low_speed_pid_conf"][0]["ki"][0],
            "speed.kp_high": lon["high_speed_pid_conf"][0]["kp"][0],
            "speed.ki_high": lon["high_speed_pid_conf"][0]["ki"][0],
        }
        assert {name: round32(value) for name, value in found.items()} == {name: values[name] for name in names}


def test_native_units_and_shipped_constants(made: ExportValues) -> None:
    files = texts(export_apollo(made))
    together = read_text_proto(files[TOGETHER])
    lat, lon = together["lat_controller_conf"][0], together["lon_controller_conf"][0]
    assert [lat[name][0] for name in ("mass_fl", "mass_fr", "mass_rl", "mass_rr")] == [520, 520, 520, 520]
    assert lat["cf"] == [155494.663] and lat["ts"] == [0.01] and lat["cutoff_freq"] == [10]
    assert lat["enable_steer_mrac_control"] == [True] and len(lat["reverse_matrix_q"]) == 4
    ratios = [(one["speed"][0], one["ratio"][0]) for one in lat["heading_err_gain_scheduler"][0]["scheduler"]]
    assert ratios == [(4, 1), (8, 0.6), (12, 0.4), (20, 0.2), (25, 0.1)]
    assert (lon["preview_window"], lon["switch_speed"], lon["standstill_acceleration"]) == ([20], [3], [-0.3])
    assert lon["station_pid_conf"][0]["integrator_enable"] == [False]
    vehicle = read_text_proto(files["vehicle_param.pb.txt"])["vehicle_param"][0]
    assert vehicle["max_steer_angle"] == [8.20305] and vehicle["throttle_deadzone"] == [15]
    assert vehicle["steering_latency_param"][0]["rise_time"] == [0.17] and vehicle["wheel_rolling_radius"] == [0.335]


def test_an_unequal_load_is_by_wheel_and_whole(made: ExportValues) -> None:
    heavy = made.vehicle._replace(mass_kg=1736.35, front_axle_m=1.27)
    export = export_apollo(made._replace(vehicle=heavy))
    lat = lateral_of(export)
    front, rear = lat["mass_fl"][0], lat["mass_rl"][0]
    assert (front, rear) == (481, 388)
    assert "1738 kg instead of 1736.35 kg" in subjects(export, RemarkKind.DIFFERS)["mass"]
    assert made.vehicle.wheelbase_m * (1.0 - front / (front + rear)) == pytest.approx(1.27, abs=0.002)


def test_the_table_is_the_map_by_apollos_lookup(made: ExportValues) -> None:
    files = texts(export_apollo(made))
    tables = [
        read_text_proto(files[TABLE]),
        read_text_proto(files[TOGETHER])["lon_controller_conf"][0]["calibration_table"][0],
    ]
    assert tables[0] == tables[1]
    table = ApolloTable(tables[0])
    largest = 0.0
    for speed_mps in np.linspace(-1.0, 35.0, 91):
        for accel_mps2 in np.linspace(-10.0, 4.0, 113):
            wanted = 100.0 * lookup(made.calibration, float(speed_mps), float(accel_mps2))
            largest = max(largest, abs(table.command(float(speed_mps), float(accel_mps2)) - wanted))
    # the sixth decimal of an acceleration, where the map jumps from the brake to the throttle
    assert largest < 0.05
    commands = [one["command"][0] for one in tables[0]["calibration"]]
    assert min(commands) < -40.0 and max(commands) > 70.0


def test_the_second_order_has_its_matrix(made: ExportValues) -> None:
    order2 = Settings(mrac_order=2)
    mrac = lateral_of(export_apollo(made._replace(settings=order2)))["steer_mrac_conf"][0]
    p11, p12, p21, p22 = mrac["adaption_matrix_p"]
    assert p12 == p21 and mrac["mrac_model_order"] == [2]
    square = order2.mrac_natural_radps**2
    assert (square * p12, square * p22) == pytest.approx(second_order_pb(made.values["mrac.p"], order2))
    assert p11 * p22 > p12 * p12


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ("[controller]\nmrac_order = 3\n", "refuses a reference model of order 3"),
        ('[controller]\nmrac_form = "paper"\n', "mrac_form = 'paper'"),
        ('[controller]\ninner = "mrac_robust"\n', "mrac_robust is not Apollo's law"),
    ],
)
def test_a_law_that_apollo_lacks_is_off_and_said(more: str, reason: str, tmp_path: Path) -> None:
    export = export_apollo(make_values(tmp_path, more))
    lat = lateral_of(export)
    assert lat["enable_steer_mrac_control"] == [False] and "steer_mrac_conf" not in lat
    text = subjects(export, RemarkKind.DIFFERS)["MRAC"]
    assert reason in text and "with MRAC on" in text
    off = export_apollo(make_values(tmp_path, more, mrac__enable=0.0))
    assert "MRAC" in subjects(off, RemarkKind.NOT_EXPORTED)


def test_gains_of_preview_parts_are_warned_of(tmp_path: Path) -> None:
    export = export_apollo(make_values(tmp_path, PREVIEW))
    differs, left = subjects(export, RemarkKind.DIFFERS), subjects(export, RemarkKind.NOT_EXPORTED)
    assert "may swing" in differs["lateral = lqr_preview"] and "longitudinal = pid_preview" in differs
    assert {"steer.preview", "steer.predict", "steer.integral_1ps", "speed.predict", "pedals.hysteresis_mps2"} <= set(
        left
    )
    lon = read_text_proto(texts(export)[TOGETHER])["lon_controller_conf"][0]
    assert lon["preview_window"] == [25]


def test_the_capped_solver_is_warned_of_with_its_size(made: ExportValues) -> None:
    converged = make_differs(made, 0.0)
    assert "23 %" in converged["riccati = converged"]
    assert "riccati = converged" not in make_differs(made, 1.0)
    for speed_mps in (1.0, 4.0):  # MKZ: the tolerance does not stop it there
        rows = [
            gain_rows((speed_mps,), (0.05, 0.0, 1.0, 0.0), made.vehicle, 0.01, shipped=is_shipped)[0]
            for is_shipped in (False, True)
        ]
        shipped = made._replace(values={**made.values, "lqr.q1": 0.05, "lqr.q3": 1.0})
        assert capped_share(shipped, speed_mps) == pytest.approx(rows[1][0] / rows[0][0], rel=1e-6)


def test_the_hint_on_the_rounds_is_enough(made: ExportValues) -> None:
    rounds = needed_rounds(made)
    assert capped_share(made, 4.0, rounds) >= 0.95 > capped_share(made, 4.0, rounds - 100)
    assert f"max_iteration: {rounds} gives 95 % at 4 m/s" in make_differs(made, 0.0)["riccati = converged"]


def test_small_weights_keep_their_gain_by_a_small_tolerance(made: ExportValues) -> None:
    """With the shipped tolerance the recursion stops in its first round and Apollo would not steer."""
    names = {"lqr.q1": 1e-3, "lqr.q2": 0.0, "lqr.q3": 5e-3, "lqr.q4": 0.0}
    small = made._replace(values={**made.values, **names})
    stopped = gain_rows((4.0,), (1e-3, 0.0, 5e-3, 0.0), made.vehicle, 0.01, shipped=True)[0][0]
    converged = gain_rows((4.0,), (1e-3, 0.0, 5e-3, 0.0), made.vehicle, 0.01, shipped=False)[0][0]
    assert stopped < 1e-3 * converged and capped_share(small, 4.0) > 0.05
    assert lateral_of(export_apollo(small))["eps"] == [1e-9]
    as_driven = small._replace(values={**small.values, "riccati": 1.0})
    assert lateral_of(export_apollo(as_driven))["eps"] == [0.01]


def make_differs(made: ExportValues, riccati: float) -> dict[str, str]:
    return subjects(export_apollo(made._replace(values={**made.values, "riccati": riccati})), RemarkKind.DIFFERS)


def test_parts_without_a_counterpart_leave_their_files_out(made: ExportValues) -> None:
    other = made._replace(parts=made.parts._replace(lateral="mpc", longitudinal="mpc"))
    export = export_apollo(other)
    assert set(texts(export)) == {TABLE, "vehicle_param.pb.txt"} and not export.exported
    left: dict[str, Any] = subjects(export, RemarkKind.NOT_EXPORTED)
    assert {"lateral = mpc", "longitudinal = mpc"} <= set(left)
