"""A message's frames decoded at once: what the codec says of each, value for value, protected or cut short or not."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import other_vehicle
from tests.bus.dbc.test_codec import ALL, CODECS, layouts, message_of
from tests.bus.e2e_car import write_car
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.decode_columns import (
    are_intact,
    are_long_enough,
    decode_fields,
    decode_signal,
    fit,
    is_there,
    payloads_of,
)
from tunefree_hil.bus.dbc.e2e import is_intact, with_crc
from tunefree_hil.bus.dbc.encode_plan import make_plan
from tunefree_hil.bus.dbc.message_map import MessageMap, SignalMap
from tunefree_hil.config.load import load_vehicle


def same(a: float, b: float) -> bool:
    return a == b or (math.isnan(a) and math.isnan(b))


def compare(codec: Codec, message: MessageMap, frames: list[bytes]) -> None:
    """Frame by frame against Codec.fits, is_intact, Codec.decode and Codec.values."""
    payloads = fit(message, payloads_of(frames))
    enough, intact = are_long_enough(message, payloads), are_intact(message, payloads)
    assert enough.tolist() == [message.fits(one) for one in frames]
    if message.e2e is not None:
        assert intact.tolist() == [is_intact(message.e2e, one[: message.length]) for one in frames]
    else:
        assert intact.all()
    good = [one for one, fits in zip(frames, enough, strict=True) if fits]
    payloads = payloads.of(enough)
    decoded = [codec.decode(message, one) for one in good]
    for name in message.signals:
        there, values = is_there(message, name, payloads), decode_signal(message, name, payloads)
        assert there.tolist() == [name in one for one in decoded]
        assert all(same(values[i], float(one[name])) for i, one in enumerate(decoded) if name in one), name
    fields = decode_fields(message, payloads)
    places = {(field.group, field.index): place for place, field in enumerate(message.fields)}
    for i, one in enumerate(decoded):
        expected = {places[group, index]: value for group, index, value in codec.values(message, one)}
        assert {place for place in places.values() if fields.is_present[i, place]} == expected.keys()
        assert all(same(fields.values[i, place], value) for place, value in expected.items())


@pytest.mark.parametrize(("vehicle", "message"), ALL, ids=[f"{v}-{m.name}" for v, m in ALL])
@given(data=st.data())
def test_frames_of_every_message_say_what_the_codec_says(
    vehicle: str, message: MessageMap, data: st.DataObject
) -> None:
    """Of every length, beyond the DBC's too; of a protected message some with the CRC that fits."""
    frames = data.draw(st.lists(st.binary(max_size=message.length + 3), max_size=6))
    whole = data.draw(st.lists(st.binary(min_size=message.length, max_size=message.length), max_size=4))
    frames += whole if message.e2e is None else [with_crc(message.e2e, one) for one in whole]
    compare(CODECS[vehicle], message, frames)


@pytest.mark.parametrize("mode", ["both", "alternating", "low", "nibble"])
@given(data=st.data())
def test_every_id_mode(mode: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    codec = e2e_codec(tmp_path_factory.getbasetemp() / f"e2e_{mode}", mode)
    for message in codec.by_name.values():
        assert message.e2e is not None
        frames = data.draw(
            st.lists(st.binary(min_size=message.length, max_size=message.length), min_size=1, max_size=5)
        )
        made = [with_crc(message.e2e, one) for one in frames]
        compare(codec, message, [*frames, *made])


def e2e_codec(folder: Path, mode: str) -> Codec:
    if not folder.exists():
        nibble = ', nibble = "ID_HIGH"'
        changes = [] if mode == "nibble" else [('id_mode = "nibble"', f'id_mode = "{mode}"'), (nibble, "")]
        write_car(folder, *changes)
    return Codec(load_vehicle(folder))


@given(layouts(), st.data())
def test_any_layout(layout: tuple, data: st.DataObject) -> None:
    """Intel and Motorola, signed and not, in up to 64 bytes; also cut short anywhere."""
    signals, length = layout
    compare(
        CODECS["mkz_bywire"], message_of(signals, length), data.draw(st.lists(st.binary(max_size=length), max_size=5))
    )


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(("bits", "form"), [(16, "e"), (32, "f"), (64, "d")])
def test_floats_on_the_wire(bits: int, form: str, big: bool) -> None:
    """Numbers, none, infinite ones."""
    order, size = (">" if big else "<"), bits // 8
    values = [0.0, -1.5, 3.25, math.inf, -math.inf, math.nan]
    frames = [b"\x55" + struct.pack(order + form, one) for one in values]
    message = one_signal(SignalMap("F", 0 if big else 8, bits, big, False, True, 2.0, 1.0, 0, 0, 8 + bits), size + 1)
    found = decode_signal(message, "F", fit(message, payloads_of(frames)))
    np.testing.assert_array_equal(found, [2.0 * one + 1.0 for one in values])


@pytest.mark.parametrize("signed", [False, True])
@given(raw=st.integers(0, 2**64 - 1), big=st.booleans(), shift=st.integers(0, 7), bits=st.integers(50, 64))
def test_integers_that_a_double_does_not_hold(signed: bool, raw: int, big: bool, shift: int, bits: int) -> None:
    message = one_signal(SignalMap("I", shift, bits, big, signed, False, 1, 0, 0, 0, 72), 9)
    data = (raw << shift).to_bytes(9, "big" if big else "little")
    expected = raw & ((1 << bits) - 1)
    expected -= (1 << bits) if signed and expected >> (bits - 1) else 0
    assert decode_signal(message, "I", fit(message, payloads_of([data])))[0] == float(expected)


def one_signal(signal: SignalMap, length: int) -> MessageMap:
    signals = {signal.name: signal}
    return replace(message_of({}, length), signals=signals, plan=make_plan(signals, (), set(), {}))


def test_no_frame_at_all() -> None:
    codec = CODECS[other_vehicle.NAME]
    for message in (*codec.commands, *codec.telemetry):
        compare(codec, message, [])
