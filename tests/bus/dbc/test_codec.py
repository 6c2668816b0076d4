"""Frames from records and back: against cantools bit for bit, against the published layout, against nonsense."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given
from hypothesis import strategies as st

from tests.house import ROOT
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GROUPS, CanFrame, Command, Ins, Report
from tunefree_hil.bus.dbc.codec import Codec, Snapshot
from tunefree_hil.bus.dbc.encode_plan import make_plan
from tunefree_hil.bus.dbc.message_map import MessageMap
from tunefree_hil.bus.dbc.network import bits_of, read_network, signal_map
from tunefree_hil.config.load import load_vehicle

VEHICLES = sorted(path.parent.name for path in (ROOT / "dbc").glob("*/vehicle.toml"))
CODECS = {name: Codec(load_vehicle(name)) for name in VEHICLES}
NETWORKS = {name: read_network(load_vehicle(name)) for name in VEHICLES}
ALL = [(name, message) for name, codec in CODECS.items() for message in (*codec.commands, *codec.telemetry)]
MKZ = CODECS["mkz_bywire"]
DEG = math.pi / 180.0


def message_of(signals: Mapping[str, Signal], length: int) -> MessageMap:
    """A message by itself, without record fields."""
    maps = {name: signal_map(signal, length) for name, signal in signals.items()}
    empty = dict.fromkeys(("enable", "clear", "ignore", "counter", "checksum", "channel"), "")
    return MessageMap(
        name="M",
        can_id=1,
        extended=False,
        fd=length > 8,
        length=length,
        kind="telemetry",
        period_ticks=1,
        timeout_ticks=0,
        fields=(),
        counter_modulus=0,
        allow_truncated=True,
        bywire=(),
        states=(),
        signals=maps,
        plan=make_plan(maps, (), set(), {}),
        **empty,
    )


@st.composite
def layouts(draw: st.DrawFn) -> tuple[dict[str, Signal], int]:
    """Signals that do not overlap, of both byte orders, signed and not, in a message of up to 64 bytes."""
    length = draw(st.sampled_from([1, 2, 3, 5, 8, 12, 64]))
    taken: set[int] = set()
    signals: dict[str, Signal] = {}
    for i in range(draw(st.integers(1, 10))):
        signal = Signal(
            f"S{i}",
            start=draw(st.integers(0, 8 * length - 1)),
            length=draw(st.integers(1, 20)),
            byte_order=draw(st.sampled_from(["little_endian", "big_endian"])),
            is_signed=draw(st.booleans()),
            conversion=BaseConversion.factory(
                scale=draw(st.sampled_from([1, 2, 0.1, -0.25, 1.0 / 65535.0])),
                offset=draw(st.sampled_from([0, -40, 2.5])),
            ),
        )
        bits = set(bits_of(signal))
        if max(bits) < 8 * length and not bits & taken:
            taken |= bits
            signals[signal.name] = signal
    return signals, length


@given(layouts(), st.data())
def test_any_layout_agrees_with_cantools(layout: tuple[dict[str, Signal], int], data: st.DataObject) -> None:
    signals, length = layout
    reference = Message(1, "M", length, list(signals.values()), is_fd=length > 8)
    message = message_of(signals, length)
    raw = {
        name: data.draw(
            st.integers(-(1 << s.length - 1), (1 << s.length - 1) - 1)
            if s.is_signed
            else st.integers(0, (1 << s.length) - 1)
        )
        for name, s in signals.items()
    }
    payload = MKZ.encode(message, {}, raw)
    assert payload == reference.encode(raw, scaling=False)
    decoded = MKZ.decode(message, payload)
    expected = reference.decode(payload, decode_choices=False)
    assert isinstance(expected, dict)
    assert decoded == {name: expected[name] for name in decoded} and decoded.keys() == signals.keys()
    short = payload[: data.draw(st.integers(0, length))]
    assert MKZ.decode(message, short) == reference.decode(short, decode_choices=False, allow_truncated=True)


@pytest.mark.parametrize(("vehicle", "message"), ALL, ids=[f"{v}-{m.name}" for v, m in ALL])
@given(data=st.data())
def test_any_payload_decodes_as_cantools_does(vehicle: str, message: MessageMap, data: st.DataObject) -> None:
    payload = data.draw(st.binary(min_size=message.length, max_size=message.length))
    reference = NETWORKS[vehicle][message.name]
    assert CODECS[vehicle].decode(message, payload) == reference.decode(payload, decode_choices=False)
    assert CODECS[vehicle].decode(message, payload + b"\x55") == CODECS[vehicle].decode(message, payload)


@pytest.mark.parametrize(("vehicle", "message"), ALL, ids=[f"{v}-{m.name}" for v, m in ALL])
@given(data=st.data())
def test_a_value_comes_back_within_half_a_step(vehicle: str, message: MessageMap, data: st.DataObject) -> None:
    codec = CODECS[vehicle]
    for field in message.fields:
        finest = field.terms[-1]
        step = abs(finest.signal.factor * finest.scale * field.scale)
        coarsest = field.terms[0].signal
        ends = [
            ((raw + inside) * coarsest.factor + coarsest.offset) * field.terms[0].scale * field.scale + field.offset
            for raw, inside in ((coarsest.raw_low, 1), (coarsest.raw_high, -1))
        ]
        value = data.draw(st.floats(min(ends), max(ends)))
        record = GROUPS[field.group]()._replace(**{field.name: value})
        heard = heard_values(codec, message, {field.group: record})[field.group, field.index]
        error = abs(heard - value)
        if field.name == "heading_rad":
            error = min(error, abs(2.0 * math.pi - error))
        assert error <= 0.5 * step * (1.0 + 1e-6) + 1e-9 * abs(value)


def heard_values(codec: Codec, message: MessageMap, records: dict) -> dict[tuple[str, int], float]:
    decoded = codec.decode(message, codec.encode(message, records, {}))
    return {(group, index): value for group, index, value in codec.values(message, decoded)}


def test_commands_are_packed_as_published() -> None:
    """docs/reference/by_wire.md, byte by byte."""
    command = Command(throttle_frac=0.4, brake_frac=0.25, steer_rad=-90.0 * DEG, gear=4.0)
    signals = {"EN": 1.0, "CLEAR": 0.0, "IGNORE": 1.0, "COUNT": 200.0}
    throttle = MKZ.encode(MKZ.by_name["THROTTLE_CMD"], {"command": command}, signals)
    assert throttle == round(0.4 * 65535).to_bytes(2, "little") + bytes([0x10, 0b101, 0, 0, 0, 200])
    brake = MKZ.encode(MKZ.by_name["BRAKE_CMD"], {"command": command}, signals)
    assert brake == round(0.25 * 65535).to_bytes(2, "little") + bytes([0x10, 0b101, 0, 0, 0, 200])
    steer = MKZ.encode(MKZ.by_name["STEERING_CMD"], {"command": command}, signals)
    assert steer == (-900).to_bytes(2, "little", signed=True) + bytes([0b101, 245, 0, 0, 0, 200])
    assert MKZ.encode(MKZ.by_name["GEAR_CMD"], {"command": command}, {"CLEAR": 1.0}) == bytes([0x84])


def test_reports_are_read_as_published() -> None:
    snapshot = Snapshot(MKZ)
    snapshot.receive(MKZ.by_name["BRAKE_REPORT"], bytes([0, 0, 255, 255, 0, 128, 0b1101_1000, 0b1000_0011]))
    snapshot.receive(MKZ.by_name["STEERING_REPORT"], bytes([0x84, 0x03, 0x7C, 0xFC, 0xE8, 0x03, 0xF0, 1]))
    snapshot.receive(MKZ.by_name["ACCEL"], bytes([100, 0, 0x38, 0xFF, 0, 0]))
    report = snapshot.report()
    assert (report.brake_input_frac, report.brake_command_frac) == (0.0, 1.0)
    assert report.brake_frac == pytest.approx(0.5, abs=1e-5)
    assert report.steer_rad == pytest.approx(90.0 * DEG) and report.steer_command_rad == pytest.approx(-90.0 * DEG)
    assert report.speed_mps == pytest.approx(10.0 / 3.6) and report.steer_torque_nm == -1.0
    assert report.lateral_accel_mps2 == -1.0, "the wire counts to the right, records to the left"
    assert report.accel_mps2 == -2.0
    assert math.isnan(report.throttle_frac), "nothing heard of it"


def test_states_are_raw_and_mapped() -> None:
    message = MKZ.by_name["BRAKE_REPORT"]
    decoded = MKZ.decode(message, bytes([0] * 6 + [0b1101_1000, 0b1000_0011]))
    found = {state.cause or state.condition for state in message.states if decoded[state.signal] == state.active}
    assert found == {"enabled", "override", "timeout", "watchdog", "steer_disabled"}
    assert decoded["DRIVER"] == 0


def test_a_clear_frame_has_four_bytes() -> None:
    message = MKZ.by_name["STEERING_CMD"]
    payload = MKZ.encode(message, {}, {"CLEAR": 1.0}, length=4)
    assert payload == bytes([0, 0, 0b10, 245])
    decoded = MKZ.decode(message, payload)
    assert decoded["CLEAR"] == 1 and "COUNT" not in decoded and decoded["SCMD"] == 0.0


def test_short_frames_are_refused_where_not_allowed() -> None:
    message = MKZ.by_name["WHEEL_SPEED"]
    assert not message.fits(bytes(7)) and message.fits(bytes(8))
    with pytest.raises(InputError, match="7 bytes") as caught:
        MKZ.decode(message, bytes(7))
    assert "allow_truncated" in caught.value.hint


@given(st.sampled_from([math.nan, math.inf, -math.inf]))
def test_what_is_no_number_is_sent_as_raw_0(value: float) -> None:
    command = Command(value, value, value, value)
    for message in MKZ.commands:
        assert MKZ.encode(message, {"command": command}, {}) == MKZ.encode(message, {}, {})
    nowhere = Ins(value, value, value, value, value, value)
    for message in MKZ.telemetry:
        assert not any(MKZ.encode(message, {"ins": nowhere}, {}))


@given(st.floats(-1e6, 1e6), st.sampled_from(["throttle_frac", "steer_rad", "gear"]))
def test_values_are_clipped_to_the_declared_range(value: float, name: str) -> None:
    limit = {"throttle_frac": (0.0, 1.0), "steer_rad": (-470.0 * DEG, 470.0 * DEG), "gear": (0.0, 5.0)}[name]
    snapshot = Snapshot(MKZ)
    for message in MKZ.commands:
        snapshot.receive(message, MKZ.encode(message, {"command": Command()._replace(**{name: value})}, {}))
    heard = getattr(snapshot.command(), name)
    assert limit[0] - 1e-9 <= heard <= limit[1] + 1e-9
    if not limit[0] <= value <= limit[1]:
        assert heard == pytest.approx(limit[0] if value < limit[0] else limit[1])


@given(st.floats(-1e4, 1e4))
def test_a_heading_is_wrapped_not_clipped(heading_rad: float) -> None:
    message = MKZ.by_name["INS_VEL_YAW_LOCAL"]
    snapshot = Snapshot(MKZ)
    snapshot.receive(message, MKZ.encode(message, {"ins": Ins()._replace(heading_rad=heading_rad)}, {}))
    difference = snapshot.ins().heading_rad - heading_rad
    assert abs(math.sin(difference)) < 1e-4 and math.cos(difference) > 0.999


def test_a_sum_gives_its_coarse_signal_first() -> None:
    codec = CODECS["rav4_2017"]
    message = codec.by_name["STEER_ANGLE_SENSOR"]
    for degrees, coarse, fraction in ((100.1, 67, -4), (-1.1, -1, 4), (0.7, 0, 7)):
        payload = codec.encode(message, {"report": Report()._replace(steer_rad=degrees * DEG)}, {})
        decoded = codec.decode(message, payload)
        assert decoded["STEER_ANGLE"] == coarse * 1.5 and decoded["STEER_FRACTION"] == pytest.approx(fraction * 0.1)
        assert codec.values(message, decoded)[0][2] == pytest.approx(degrees * DEG)


def test_messages_are_in_id_order_with_what_a_node_needs() -> None:
    ids = [message.can_id for message in MKZ.commands]
    assert ids == [0x60, 0x62, 0x64, 0x66, 0x68]
    assert [m.can_id for m in MKZ.telemetry] == sorted(m.can_id for m in MKZ.telemetry)
    assert {m.can_id for m in MKZ.telemetry} >= {0x61, 0x63, 0x65, 0x67, 0x6A, 0x6B, 0x6C}
    assert [m.period_ticks for m in MKZ.commands] == [1, 1, 1, 1, 5]
    assert {m.name: m.period_ticks for m in MKZ.telemetry if m.period_ticks > 1} == {
        "BRAKE_REPORT": 2,
        "THROTTLE_REPORT": 2,
        "GEAR_REPORT": 5,
    }
    steer = MKZ.by_id[0x64]
    assert (steer.enable, steer.clear, steer.ignore, steer.counter) == ("EN", "CLEAR", "IGNORE", "COUNT")
    assert (steer.counter_modulus, steer.timeout_ticks, steer.bywire) == (256, 10, ("steer",))
    assert MKZ.by_name["BRAKE_REPORT"].bywire == ("brake",)


def test_the_same_id_on_two_channels() -> None:
    codec = CODECS["rav4_2017"]
    frame = CanFrame(0x343, bytes(8))
    assert codec.find(frame, "can128") is codec.by_name["ACC_CONTROL"]
    assert codec.find(frame, "can129") is None, "it carries something else there"
    assert codec.find(frame) is codec.by_name["ACC_CONTROL"]
    assert codec.find(frame._replace(extended=True)) is None


def test_a_logs_channels_are_the_folders_when_all_were_heard() -> None:
    codec = CODECS["rav4_2017"]
    assert codec.has_channels(["can0", "can1", "can0", "can128"])
    assert not codec.has_channels(["can0", "can1"] * 3) and not codec.has_channels([])
    heard = iter(["can128", "can0", "can1", "can2"])
    assert codec.has_channels(heard) and list(heard) == ["can1", "can2"], "no further than needed"
    heard = iter(["can0"])
    assert not MKZ.has_channels(heard) and list(heard) == ["can0"], "that folder names none"


@given(st.floats(width=32, allow_nan=False), st.sampled_from(["little_endian", "big_endian"]))
def test_a_floating_point_signal_is_read(value: float, byte_order: str) -> None:
    start = 8 if byte_order == "little_endian" else 15
    conversion = BaseConversion.factory(scale=0.5, offset=1.0, is_float=True)
    signal = Signal("F", start, 32, byte_order, is_signed=True, conversion=conversion)  # type: ignore[arg-type]
    reference = Message(1, "M", 6, [signal])
    payload = reference.encode({"F": value}, scaling=False)
    assert MKZ.decode(message_of({"F": signal}, 6), payload) == reference.decode(payload)


@given(payload=st.binary(min_size=64, max_size=64))
def test_take_gives_what_hear_gives(payload):
    for codec in CODECS.values():
        heard, taken = Snapshot(codec), Snapshot(codec)
        for message in (*codec.commands, *codec.telemetry):
            heard.receive(message, payload[: message.length])
            taken.take(message, payload[: message.length])
        for read in ("report", "ins", "command"):
            assert repr(getattr(heard, read)()) == repr(getattr(taken, read)())
