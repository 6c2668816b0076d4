"""The wire Block is the bus: the same bits as encode and decode, tick by tick, and the same holding."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.kernel import run
from tunefree_hil.base.records import GROUPS, Command, Ins
from tunefree_hil.bus.dbc.codec import Codec, Snapshot
from tunefree_hil.bus.dbc.quantise import rint, to_raw, wrap_turn
from tunefree_hil.bus.dbc.wire_block import phases, wire
from tunefree_hil.config.load import load_vehicle

CODECS = {name: Codec(load_vehicle(name)) for name in ("mkz_bywire", "rav4_2017")}
MKZ = CODECS["mkz_bywire"]
VALUES = st.one_of(
    st.floats(-20.0, 20.0),
    st.floats(-1e7, 1e7),
    st.sampled_from([0.0, -0.0, math.nan, math.inf, -math.inf, 0.15, math.pi]),
)


def same(one: Any, other: Any) -> bool:
    """Bit for bit, NaN equal to NaN, 0.0 not equal to -0.0."""
    return all(
        math.copysign(1.0, a) == math.copysign(1.0, b) and (a == b or (a != a and b != b))
        for a, b in zip(one, other, strict=True)
    )


def over_the_bus(codec: Codec, group: str, sent: list[Any], phase: dict[str, int]) -> list[Any]:
    """What a Snapshot knows after each tick, when the frames really are made and read."""
    snapshot, heard = Snapshot(codec), []
    for k, record in enumerate(sent):
        for message in (*codec.commands, *codec.telemetry):
            if (k + phase[message.name]) % message.period_ticks == 0:
                snapshot.receive(message, codec.encode(message, {group: record}, {}))
        heard.append(getattr(snapshot, group)())
    return heard


@pytest.mark.parametrize("vehicle", CODECS)
@pytest.mark.parametrize("group", GROUPS)
@given(data=st.data())
def test_wire_is_encode_and_decode(vehicle: str, group: str, data: st.DataObject) -> None:
    codec, kind = CODECS[vehicle], GROUPS[group]
    phase = phases(codec, data.draw(st.integers(0, 1000)))
    rows = data.draw(
        st.lists(st.lists(VALUES, min_size=len(kind._fields), max_size=len(kind._fields)), min_size=1, max_size=8)
    )
    sent = [kind(*row) for row in rows]
    for one, other in zip(
        run(wire(codec, group, phase), sent, 0.01), over_the_bus(codec, group, sent, phase), strict=True
    ):
        assert same(one, other)


def test_a_field_is_held_between_transmissions() -> None:
    phase = dict.fromkeys(phases(MKZ, 1), 0) | {"GEAR_REPORT": 2}
    kind = GROUPS["report"]
    sent = [kind()._replace(gear=float(k % 6), yaw_rate_radps=0.0002 * k, throttle_frac=k / 65535.0) for k in range(12)]
    heard = run(wire(MKZ, "report", phase), sent, 0.01)
    assert [row.yaw_rate_radps for row in heard] == pytest.approx([0.0002 * k for k in range(12)])
    assert [row.throttle_frac * 65535.0 for row in heard] == pytest.approx([k - k % 2 for k in range(12)])
    gears = [row.gear for row in heard]
    assert all(math.isnan(gear) for gear in gears[:3])
    assert gears[3:] == [3.0] * 5 + [2.0] * 4


def test_a_value_that_was_just_sent_is_only_quantised() -> None:
    sent = [Command(k / 13.0, 0.2, 0.1 * k, 4.0) for k in range(10)]
    heard = run(wire(MKZ, "command", {}), sent, 0.01)
    period = MKZ.by_name["THROTTLE_CMD"].period_ticks
    just_sent = list(zip(sent, heard, strict=True))[::period]
    assert all(abs(a.throttle_frac - b.throttle_frac) <= 0.5 / 65535.0 + 1e-12 for a, b in just_sent)
    assert all(math.isnan(row.accel_mps2) for row in heard), "the vehicle has no such command"


@given(st.floats(-(2.0**51), 2.0**51))
def test_rint_is_pythons_round(value: float) -> None:
    assert rint(value) == round(value)


@given(st.integers(-(2**50), 2**50))
def test_halves_go_to_the_even_number(whole: int) -> None:
    assert rint(whole + 0.5) == round(whole + 0.5)


@given(st.floats(-1e8, 1e8), st.sampled_from([-math.pi, 0.0, 1.0]))
def test_a_wrapped_angle_is_within_one_turn(angle: float, low: float) -> None:
    wrapped = wrap_turn(angle, low)
    assert low - 1e-6 <= wrapped <= low + 2.0 * math.pi + 1e-6
    assert math.isclose(math.cos(wrapped - angle), 1.0, abs_tol=1e-6)


def test_an_angle_leaves_one_end_and_comes_in_at_the_other() -> None:
    """0..359.99 degrees in steps of 0.01: 359.997 is 0.00, not 359.99."""
    assert to_raw(35999.7, 0.0, 35999.0, 36000.0) == 0.0
    assert to_raw(35999.3, 0.0, 35999.0, 36000.0) == 35999.0
    assert to_raw(-0.7, 0.0, 35999.0, 36000.0) == 35999.0


def test_phases_are_seeded_and_within_their_period() -> None:
    assert phases(MKZ, 7) == phases(MKZ, 7)
    drawn = [phases(MKZ, seed) for seed in range(40)]
    assert {row["GEAR_REPORT"] for row in drawn} == {0, 1, 2, 3, 4}
    assert {row["BRAKE_REPORT"] for row in drawn} == {0, 1}
    assert {row["ACCEL"] for row in drawn} == {0}


COMPILED = """
import random
from tunefree_hil.base.kernel import JITTED, run
from tunefree_hil.base.records import GROUPS
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.wire_block import phases, wire
from tunefree_hil.config.load import load_vehicle
chance = random.Random(5)
for name in ("mkz_bywire", "rav4_2017"):
    codec = Codec(load_vehicle(name))
    for group, kind in GROUPS.items():
        draw = lambda: chance.choice([chance.uniform(-9.0, 9.0), chance.uniform(-1e5, 1e5)])
        sent = [kind(*[draw() for _ in kind._fields]) for _ in range(60)]
        for row in run(wire(codec, group, phases(codec, 3)), sent, 0.01):
            print(*[value.hex() for value in map(float, row)])
"""


@pytest.mark.compiled
def test_compiled_gives_the_same_bits(repo: Path) -> None:
    said = [
        subprocess.run(
            [sys.executable, "-c", COMPILED],
            cwd=repo,
            env={**os.environ, "TUNEFREE_JIT": jit},
            capture_output=True,
            text=True,
            timeout=110,
            check=True,
        ).stdout
        for jit in ("0", "1")
    ]
    assert said[0] == said[1] and said[0].count("\n") == 2 * 3 * 60


def test_heading_is_wrapped_on_the_wire() -> None:
    heard = run(wire(MKZ, "ins", {}), [Ins(heading_rad=turn) for turn in (3.5, -3.5, 100.0)], 0.01)
    assert [row.heading_rad for row in heard] == pytest.approx(
        [3.5 - 2.0 * math.pi, 2.0 * math.pi - 3.5, 100.0 - 32.0 * math.pi], abs=1e-4
    )
