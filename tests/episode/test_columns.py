"""From frames to columns: what is heard when, what is absent, and that the follower sees what the controller saw."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pytest

from tunefree_hil.base.course import Tracking
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import CanFrame, Command, Ins, Report
from tunefree_hil.episode.candump import RTR, LogFrame
from tunefree_hil.episode.columns import SOURCES, columns_from_frames
from tunefree_hil.episode.recording import COLUMNS

TICK_S = 0.01
RECORDS: dict[str, Any] = {"command": Command, "report": Report, "ins": Ins}


class FakeMessage(NamedTuple):
    """One byte a field."""

    key: int
    name: str
    group: str
    fields: tuple[str, ...]
    channel: str = ""
    e2e: None = None

    def fits(self, data: bytes) -> bool:
        return len(data) >= len(self.fields)


class FakeCodec:
    """As bus/dbc/codec.py is used here, for messages of one byte a field."""

    name = "fake"

    def __init__(self, *messages: FakeMessage) -> None:
        self.by_id = {message.key: message for message in messages}
        self.commands = [message for message in messages if message.group == "command"]
        self.decoded = 0

    def find(self, frame: CanFrame, channel: str = "") -> FakeMessage | None:
        message = self.by_id.get(frame.id)
        return None if message is None or (channel and message.channel not in ("", channel)) else message

    def decode(self, message: FakeMessage, data: bytes) -> dict[str, float]:
        self.decoded += 1
        return {name: float(value) for name, value in zip(message.fields, data, strict=True)}

    def values(self, message: FakeMessage, decoded: Mapping[str, float]) -> list[tuple[str, int, float]]:
        fields = RECORDS[message.group]._fields
        return [(message.group, fields.index(name), value) for name, value in decoded.items()]


def spy() -> Block:
    """A follower that says what it was given: station error = x, replan at tick 2, NaN before the first fix."""

    def step(params: Any, state: int, x: tuple[int, Ins], dt_s: float) -> tuple[int, Tracking]:
        tick, fix = x
        assert tick == state
        return state + 1, Tracking(station_error_m=fix.x_m, ref_speed_mps=fix.speed_mps, replan=float(tick == 2))

    return Block(lambda params, dt_s: 0, step, None)


STEER = FakeMessage(0x64, "STEER_CMD", "command", ("steer_rad",))
PEDALS = FakeMessage(0x62, "PEDAL_CMD", "command", ("throttle_frac", "brake_frac"))
CHASSIS = FakeMessage(0x65, "CHASSIS", "report", ("speed_mps", "steer_rad"))
FIX = FakeMessage(0x600, "FIX", "ins", ("x_m", "y_m", "heading_rad", "speed_mps", "yaw_rate_radps"))


def frame(k: float, message: FakeMessage, *data: int, channel: str = "can0") -> LogFrame:
    return LogFrame(k * TICK_S, channel, message.key, bytes(data))


def columns(*frames: LogFrame, messages: tuple[FakeMessage, ...] = (STEER, PEDALS, CHASSIS, FIX), **more: Any) -> Any:
    codec: Any = FakeCodec(*messages)
    return columns_from_frames(frames, codec, spy(), TICK_S, **more)


def same(found: np.ndarray, *expected: float) -> None:
    np.testing.assert_array_equal(found, np.array(expected))


def test_reports_and_fixes_of_phase_0_and_commands_of_phase_1() -> None:
    """The order within a tick on the wire does not matter; values hold until the next frame."""
    recording = columns(
        frame(0, STEER, 7), frame(0, CHASSIS, 10, 1), frame(0, FIX, 1, 2, 3, 4, 5),
        frame(1, FIX, 2, 2, 3, 4, 5),
        frame(2, CHASSIS, 12, 2), frame(2, STEER, 8), frame(2, FIX, 3, 2, 3, 4, 5),
        frame(3, PEDALS, 50, 60),
    )  # fmt: skip
    assert recording.ticks == 4
    same(recording.columns["x_m"], 1, 2, 3, 3)
    same(recording.columns["station_error_m"], 1, 2, 3, 3)
    same(recording.columns["speed_mps"], 10, 10, 12, 12)
    same(recording.columns["out_steer_rad"], 1, 1, 2, 2)
    same(recording.columns["cmd_steer_rad"], 7, 7, 8, 8)
    same(recording.columns["cmd_throttle_frac"], math.nan, math.nan, math.nan, 50)
    same(recording.columns["replan"], 0, 0, 1, 0)
    same(recording.columns["tick"], 0, 1, 2, 3)


def test_what_is_missing_is_absent_and_what_stands_in_is_said() -> None:
    recording = columns(frame(0, FIX, 1, 2, 3, 4, 5), frame(1, CHASSIS, 10, 1), ticks=3)
    assert recording.instead == {"yaw_rate_radps": "ins.yaw_rate_radps"}
    same(recording.columns["yaw_rate_radps"], 5, 5, 5)
    same(recording.columns["speed_mps"], math.nan, 10, 10)
    absent = {"cmd_steer_rad", "accel_mps2", "lateral_accel_mps2", "out_brake_frac", "ref_x_m"}
    assert not absent & recording.columns.keys()


def test_without_ins_nothing_is_said_of_errors() -> None:
    recording = columns(frame(0, CHASSIS, 10, 1), frame(1, CHASSIS, 11, 1), messages=(STEER, CHASSIS))
    assert set(recording.columns) == {"t_s", "tick", "speed_mps", "out_steer_rad"}


def test_real_time_uses_what_came_before_the_deadline() -> None:
    """A fix stamped in tick 0 is what cycle 1 uses; a command is stamped in its own cycle."""
    frames = (
        frame(0.1, FIX, 1, 2, 3, 4, 5),
        frame(0.3, STEER, 7),
        frame(1.1, FIX, 2, 2, 3, 4, 5),
        frame(1.3, STEER, 8),
    )
    recording = columns(*frames, late_ticks=1, ticks=2)
    same(recording.columns["x_m"], math.nan, 1)
    same(recording.columns["cmd_steer_rad"], 7, 8)


def test_time_zero_may_be_anywhere() -> None:
    frames = [frame(0, FIX, 1, 2, 3, 4, 5), frame(1, STEER, 7)]
    later = [item._replace(time_s=item.time_s + 777.7) for item in frames]
    one, other = columns(*frames), columns(*later, zero_s=777.7)
    assert list(one.columns) == list(other.columns)
    for name, values in one.columns.items():
        np.testing.assert_array_equal(values, other.columns[name])


def test_channels_tell_equal_ids_apart() -> None:
    chassis = CHASSIS._replace(channel="can0")
    frames = (frame(0, chassis, 10, 1), frame(0, chassis, 99, 1, channel="can1"))
    assert columns(*frames, messages=(chassis,), by_channel=True).columns["speed_mps"][0] == 10.0
    assert columns(*frames, messages=(chassis,)).columns["speed_mps"][0] == 99.0


def test_short_and_remote_frames_say_nothing() -> None:
    remote = LogFrame(0.02, "can0", CHASSIS.key, b"\x63\x01", RTR)
    recording = columns(frame(0, CHASSIS, 10, 1), frame(1, CHASSIS, 11), remote, ticks=3)
    same(recording.columns["speed_mps"], 10, 10, 10)


def test_an_unchanged_payload_is_decoded_once() -> None:
    codec: Any = FakeCodec(CHASSIS)
    columns_from_frames([frame(k, CHASSIS, 10, 1) for k in range(50)], codec, spy(), TICK_S)
    assert codec.decoded == 1


def test_a_log_of_another_vehicle() -> None:
    stranger = FakeMessage(0x777, "OTHER", "report", ("speed_mps",))
    with pytest.raises(InputError, match=r"not one frame of vehicle 'fake' \(ids in it: 0x777\)"):
        columns(frame(0, stranger, 1))


def test_every_vehicle_column_has_a_source_that_exists() -> None:
    assert {name for name in COLUMNS if not name.startswith(("ref_", "cmd_")) and "error" not in name} == {
        *SOURCES, "t_s", "tick", "replan"
    }  # fmt: skip
    for source in (text for sources in SOURCES.values() for text in sources):
        group, field = source.split(".")
        assert field in RECORDS[group]._fields
