"""What a node makes of frames: values, state bits, the age of each message."""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.bus.e2e_car import write_car
from tunefree_hil.base.records import CanFrame, Ins, Report
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.integrity import E2eStatus
from tunefree_hil.bus.recording.frame_writer import FrameWriter
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.nodes.handshake import VehicleState
from tunefree_hil.nodes.measurement_decoder import CHASSIS, INS, MeasurementDecoder

ENABLED = ("BRAKE_REPORT", "THROTTLE_REPORT", "STEERING_REPORT")


def frame(
    codec: Codec, name: str, signals: Mapping[str, float] | None = None, report: Report | None = None
) -> CanFrame:
    message = codec.by_name[name]
    records = {"report": report} if report is not None else {}
    return CanFrame(message.can_id, codec.encode(message, records, signals or {}), message.extended, message.fd)


def enabled_frames(codec: Codec) -> list[CanFrame]:
    return [frame(codec, name, {"ENABLED": 1.0}) for name in ENABLED]


def test_nothing_heard_is_nan_and_unknown(codec: Codec) -> None:
    decoder = MeasurementDecoder(codec, 0.01)
    assert all(math.isnan(value) for record in decoder.measurement() for value in record)
    assert decoder.state() == VehicleState()._replace(enabled=True)
    assert not decoder.state().known


def test_values_are_kept_until_the_next(codec: Codec) -> None:
    decoder = MeasurementDecoder(codec, 0.01)
    report = Report()._replace(speed_mps=5.0, steer_rad=0.5)
    decoder.receive(0, [frame(codec, "STEERING_REPORT", report=report)])
    decoder.receive(1, [frame(codec, "GYRO", report=Report()._replace(yaw_rate_radps=0.1))])
    heard = decoder.measurement()
    assert heard.report.speed_mps == pytest.approx(5.0, abs=0.01)
    assert heard.report.steer_rad == pytest.approx(0.5, abs=0.01)
    assert heard.report.yaw_rate_radps == pytest.approx(0.1, abs=0.001)
    assert heard.ins == pytest.approx(Ins(), nan_ok=True)


def test_every_channel_must_say_enabled(codec: Codec) -> None:
    decoder = MeasurementDecoder(codec, 0.01)
    for name in ENABLED[:2]:
        decoder.receive(0, [frame(codec, name, {"ENABLED": 1.0})])
        assert not decoder.state().known
    decoder.receive(0, [frame(codec, ENABLED[2], {"ENABLED": 0.0})])
    assert decoder.state() == VehicleState(known=True, enabled=False)
    decoder.receive(1, [frame(codec, ENABLED[2], {"ENABLED": 1.0})])
    assert decoder.state() == VehicleState(known=True, enabled=True)


@pytest.mark.parametrize(
    ("message", "signal", "value", "condition"),
    [
        ("BRAKE_REPORT", "OVERRIDE", 1.0, "override"),
        ("GEAR_REPORT", "OVERRIDE", 1.0, "override"),
        ("THROTTLE_REPORT", "FLT1", 1.0, "fault"),
        ("STEERING_REPORT", "FLTCAL", 1.0, "fault"),
        ("BRAKE_REPORT", "FLTWDC", 1.0, "fault"),
        ("STEERING_REPORT", "TMOUT", 1.0, "fault"),
        ("BRAKE_REPORT", "WDCBRK", 1.0, "fault"),
        ("BRAKE_REPORT", "WDCSRC", 14.0, "fault"),
        ("GEAR_REPORT", "FLTBUS", 1.0, ""),  # effect "warn"
    ],
)
def test_state_bits(codec: Codec, message: str, signal: str, value: float, condition: str) -> None:
    decoder = MeasurementDecoder(codec, 0.01)
    decoder.receive(0, enabled_frames(codec))
    own = {"ENABLED": 1.0} if message in ENABLED else {}
    decoder.receive(1, [frame(codec, message, {**own, signal: value})])
    expected = VehicleState(known=True, enabled=True, override=condition == "override", fault=condition == "fault")
    assert decoder.state() == expected
    decoder.receive(2, [frame(codec, message, own)])
    assert decoder.state() == VehicleState(known=True, enabled=True)


def test_the_age_of_a_message(codec: Codec) -> None:
    """0.2 s, counted from tick 0 for what was never heard; the same payload again is heard too."""
    needed = {INS: ["INS_POS_LOCAL"], CHASSIS: ["STEERING_REPORT"]}
    decoder = MeasurementDecoder(codec, 0.01)
    same = frame(codec, "INS_POS_LOCAL")
    for k in range(0, 31, 10):
        decoder.receive(k, [same, frame(codec, "STEERING_REPORT")])
    assert decoder.missing(50, needed) is None
    assert decoder.missing(51, needed) == (INS, ["INS_POS_LOCAL"])
    decoder.receive(51, [same])
    assert decoder.missing(51, needed) == (CHASSIS, ["STEERING_REPORT"])
    assert MeasurementDecoder(codec, 0.01).missing(20, needed) is None
    assert MeasurementDecoder(codec, 0.01).missing(21, needed) == (INS, ["INS_POS_LOCAL"])


@given(st.lists(st.sets(st.sampled_from(["INS_POS_LOCAL", "STEERING_REPORT"])), min_size=40, max_size=90))
def test_asked_at_every_tick_it_finds_the_same_as_asked_once(codec: Codec, received: list[set[str]]) -> None:
    """The first tick at which a message is missing, whatever was answered before it."""
    needed = {INS: ["INS_POS_LOCAL"], CHASSIS: ["STEERING_REPORT"]}
    decoder, last = MeasurementDecoder(codec, 0.01), {"INS_POS_LOCAL": 0, "STEERING_REPORT": 0}
    for k, names in enumerate(received):
        decoder.receive(k, [frame(codec, name) for name in names])
        last |= dict.fromkeys(names, k)
        late = [(group, names) for group, names in needed.items() if k - last[names[0]] > 20]
        assert decoder.missing(k, needed) == (late[0] if late else None)


PAYLOAD = st.binary(min_size=8, max_size=9)


@given(st.lists(st.tuples(st.sampled_from(ENABLED), st.sampled_from([8, 8, 5]), PAYLOAD), max_size=12))
def test_what_was_heard_before_leaves_no_trace(codec: Codec, heard: list[tuple[str, int, bytes]]) -> None:
    """Values and state bits are those of a decoder that heard the last payload of each message only.

    The lower bytes, with values only, change more often than the rest, which is where state bits are told.
    """
    decoder, last = MeasurementDecoder(codec, 0.01), {}
    for k, (name, keep, payload) in enumerate(heard):
        data = payload[:keep] + bytes(8 - keep)
        last[name] = CanFrame(codec.by_name[name].can_id, data)
        decoder.receive(k, [last[name]])
        decoder.state()
    fresh = MeasurementDecoder(codec, 0.01)
    fresh.receive(0, last.values())
    assert decoder.state() == fresh.state()
    assert repr(decoder.measurement()) == repr(fresh.measurement())


def test_a_longer_tick_has_fewer_ticks_in_its_limit(codec: Codec) -> None:
    needed = {CHASSIS: ["GYRO"]}
    assert MeasurementDecoder(codec, 0.02).missing(10, needed) is None
    assert MeasurementDecoder(codec, 0.02).missing(11, needed) == (CHASSIS, ["GYRO"])


@pytest.mark.parametrize(("period", "timeout", "limit"), [(50, 0, 125), (50, 300, 300), (2, 0, 20)])
def test_a_slow_message_has_longer(codec: Codec, period: int, timeout: int, limit: int) -> None:
    """Its first frame may not be believed, if it is protected, and then it is heard after two periods."""
    slow = copy(codec)
    changed = {"period_ticks": period, "timeout_ticks": timeout}
    slow.telemetry = tuple(replace(one, **changed) if one.name == "GYRO" else one for one in codec.telemetry)
    decoder = MeasurementDecoder(slow, 0.01)
    assert decoder.missing(limit, {CHASSIS: ["GYRO"]}) is None
    assert decoder.missing(limit + 1, {CHASSIS: ["GYRO"]}) == (CHASSIS, ["GYRO"])


@given(st.data())
def test_a_frame_of_any_length_ends_nothing(codec: Codec, data: st.DataObject) -> None:
    """Another node's frame with one of the vehicle's ids, cut off anywhere: the values are those before it."""
    message = data.draw(st.sampled_from(codec.telemetry))
    decoder = MeasurementDecoder(codec, 0.01)
    decoder.receive(0, [CanFrame(one.can_id, bytes(one.length), one.extended, one.fd) for one in codec.telemetry])
    before = decoder.measurement(), decoder.state()
    short = data.draw(st.binary(max_size=message.length - 1))
    decoder.receive(1, [CanFrame(message.can_id, short, message.extended, message.fd)])
    assert (decoder.measurement(), decoder.state()) == before and decoder.heard_at[message.name] == 0
    assert decoder.reception.too_short == {message.name: 1}


@pytest.fixture
def little(tmp_path: Path) -> Codec:
    return Codec(load_vehicle(write_car(tmp_path)))


def protected(writer: FrameWriter, speed_mps: float, enabled: float = 1.0) -> CanFrame:
    message = writer.codec.by_name["STATE"]
    return writer.write(message, {"report": Report()._replace(speed_mps=speed_mps)}, {"EN": enabled}, 0.0)


def test_a_protected_report_is_invalid_until_proven(little: Codec) -> None:
    decoder, writer = MeasurementDecoder(little, 0.01), FrameWriter(little)
    decoder.receive(0, [protected(writer, 3.0)])
    assert math.isnan(decoder.measurement().report.speed_mps) and not decoder.state().known
    decoder.receive(2, [protected(writer, 4.0)])
    assert decoder.measurement().report.speed_mps == pytest.approx(4.0) and decoder.state().known


def test_a_broken_or_repeated_report_changes_nothing(little: Codec) -> None:
    decoder, writer = MeasurementDecoder(little, 0.01), FrameWriter(little)
    good = [protected(writer, 3.0) for _ in range(2)]
    decoder.receive(0, good[:1])
    decoder.receive(2, good[1:])
    other = protected(writer, 9.0, 0.0)
    decoder.receive(4, [other._replace(data=other.data[:-1] + b"\x01")])
    assert decoder.measurement().report.speed_mps == pytest.approx(3.0) and decoder.state().enabled
    decoder.receive(6, good[1:])
    assert decoder.heard_at["STATE"] == 2, "a repeated frame is no news"


def test_a_report_that_is_not_believed_for_0_2_s_is_missing_with_its_status(little: Codec) -> None:
    """Whether anybody asked for it or not."""
    decoder, writer = MeasurementDecoder(little, 0.01), FrameWriter(little)
    needed: dict[str, list[str]] = {INS: [], CHASSIS: []}
    for k in range(0, 10, 2):
        decoder.receive(k, [protected(writer, 3.0)])
    for k in range(10, 30, 2):
        frame = protected(writer, 3.0)
        decoder.receive(k, [frame._replace(data=bytes((frame.data[0] ^ 255,)) + frame.data[1:])])
        assert decoder.missing(k, needed) is None
    assert decoder.missing(29, needed) == (CHASSIS, ["STATE"])
    assert decoder.why("STATE") == "STATE (wrong CRC)" and decoder.why("OTHER") == "OTHER"
    assert decoder.reception.troubles()["STATE"][E2eStatus.WRONG_CRC] == 10
