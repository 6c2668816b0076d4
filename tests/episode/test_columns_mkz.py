"""A whole drive through the real codec and the real follower: what went onto the wire comes back as columns."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests import other_vehicle
from tests.episode.candump_text import read_text
from tests.house import ROOT
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import Command, Ins, Report
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.recording.frame_writer import FrameWriter
from tunefree_hil.config.load import load_scenario, load_vehicle
from tunefree_hil.control.follower import make_follower
from tunefree_hil.episode.candump import EXTENDED_BIT, LogFrame
from tunefree_hil.episode.columns import columns_from_frames
from tunefree_hil.episode.feasible import limits_of, require_feasible
from tunefree_hil.episode.recording import COLUMNS
from tunefree_hil.episode.scenario import build_course

TICKS, DT_S, REAR_AXLE_M = 300, 0.01, 1.4224
SPEC = load_scenario(ROOT / "bench_configs" / "scenarios" / "side_pass.toml")
COURSE = build_course(SPEC, DT_S)
VEHICLE = load_vehicle(ROOT / "dbc" / "mkz_bywire")


def offset_m(k: int) -> float:
    return 0.3 * math.sin(0.02 * k)


def log() -> str:
    """A vehicle that weaves 0.3 m about the straight first part of a side-pass, each message in its period."""
    codec, lines = Codec(VEHICLE), []
    for k in range(TICKS):
        report = Report._make([*[0.15] * 6, 0.1, 0.2, 6.0, *[18.0] * 4, 0.3, -0.4, 0.05, 4.0, *[math.nan] * 3])
        records = {
            "report": report,
            "ins": Ins(float(COURSE.station_m[k]), offset_m(k), 0.0, 6.0, 0.3, 0.05),
            "command": Command(0.25, 0.15, 0.01 * (k % 7), 4.0),
        }
        for message in (*codec.commands, *codec.telemetry):
            if k % message.period_ticks == 0:
                digits = f"{message.can_id:08X}" if message.key & EXTENDED_BIT else f"{message.can_id:03X}"
                lines.append(f"({k * DT_S:.6f}) vcan0 {digits}#{codec.encode(message, records, {}).hex()}")
    return "\n".join(lines) + "\n"


def test_from_wire_to_columns() -> None:
    frames = read_text(log())
    recording = columns_from_frames(frames, Codec(VEHICLE), make_follower(COURSE, REAR_AXLE_M), DT_S)
    assert list(recording.columns) == list(COLUMNS)
    assert recording.ticks == TICKS
    assert recording.instead == {}
    columns = recording.columns
    k = np.arange(150)  # up to here the path is straight
    np.testing.assert_allclose(columns["lateral_error_m"][k], [offset_m(i) for i in range(150)], atol=0.002)
    np.testing.assert_allclose(columns["station_error_m"][k], 0.0, atol=0.002)
    np.testing.assert_allclose(columns["cmd_steer_rad"], 0.01 * (np.arange(TICKS) % 7), atol=0.001)
    assert columns["cmd_throttle_frac"][0] == pytest.approx(0.25, abs=1e-4)
    for name, value in (("out_steer_rad", 0.2), ("speed_mps", 6.0), ("accel_mps2", 0.3), ("yaw_rate_radps", 0.05)):
        np.testing.assert_allclose(columns[name], value, atol=0.02, err_msg=name)
    assert columns["replan"][k].sum() == 0.0
    assert columns["replan"].sum() >= 1.0  # it went straight on where the path turns off


def test_every_scenario_suits_the_vehicle_folder() -> None:
    """The limits of vehicle.toml, not numbers of this test."""
    for path in sorted((ROOT / "bench_configs" / "scenarios").glob("*.toml")):
        spec = load_scenario(path)
        require_feasible(spec, build_course(spec, DT_S), limits_of(VEHICLE))


def test_a_frame_that_was_corrupted_on_its_way_says_nothing() -> None:
    codec = Codec(load_vehicle(other_vehicle.FOLDER))
    message = next(one for one in codec.telemetry if one.e2e is not None and "speed_mps" in str(one.fields))
    writer, frames = FrameWriter(codec), []
    for k, speed_mps in enumerate((5.0, 6.0, 7.0)):
        frame = writer.write(message, {"report": Report()._replace(speed_mps=speed_mps)}, {}, k * DT_S)
        data = bytearray(frame.data)
        if k == 1:
            data[-1] ^= 0x10
        frames.append(LogFrame(k * DT_S, "can0", message.key, bytes(data)))
    nobody = Block(lambda params, dt_s: None, lambda params, state, x, dt_s: (state, params), Tracking())
    speeds = columns_from_frames(frames, codec, nobody, DT_S).columns["speed_mps"]
    assert speeds[1] == speeds[0] == pytest.approx(5.0, abs=0.05) and speeds[2] == pytest.approx(7.0, abs=0.05)
