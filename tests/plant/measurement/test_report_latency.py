"""Frames that are late as a whole: echoes, outputs and the by-wire unit's bits by the same ticks, the INS in time."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.effects.shared import EFFECTS, same
from tests.plant.drives import DT_S, car
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import Disturbance
from tunefree_hil.plant.actuation.bywire import (
    ByWireParams,
    ByWireStatus,
    ChannelStatus,
    ReceivedChannel,
    ReceivedCommand,
    bywire,
)
from tunefree_hil.plant.ecu import ReportedState, UnitInput, make_unit
from tunefree_hil.plant.measurement.report_latency import (
    STATUS_WIDTH,
    delay_status,
    init_status_delay,
    pack_status,
    report_latency,
    unpack_status,
)
from tunefree_hil.plant.types import Driver
from tunefree_hil.plant.vehicle import for_episode

BIT = st.sampled_from([0.0, 1.0])
CHANNEL = st.builds(ChannelStatus, BIT, BIT, BIT, BIT, BIT, st.sampled_from([0.0, 1.0, 2.0]))
STATUS = st.builds(ByWireStatus, CHANNEL, CHANNEL, CHANNEL, BIT, BIT, st.integers(0, 13).map(float), BIT, BIT, BIT)


def said(*latencies_s: float, report_ticks: int = 1) -> list[ReportedState]:
    """What the frames of ticks 0..60 say: enabled from tick 5 on, disabled at 40, the foot on the brake in between."""
    effects = tuple((EFFECTS["report_latency"], {"delay_s": delay_s}) for delay_s in latencies_s)
    body = for_episode(car("physics", effects=effects), Start(speed_mps=8.0))
    unit = make_unit(body, bywire(ByWireParams()), 1, report_ticks)
    params, state, now = unit.start(body, DT_S)
    found = [now]
    for k in range(60):
        on = ReceivedChannel(0.2 + 0.002 * k, 1.0 if 5 <= k < 40 else 0.0, fresh=1.0)
        heard = ReceivedCommand(on, on, on._replace(value=math.sin(0.1 * k)), 4.0)
        foot = Driver(brake_frac=0.2 if 20 < k < 30 else 0.15)
        state, now = unit.step(params, state, UnitInput(heard, foot, Disturbance()), DT_S)
        found.append(now)
    return found


@pytest.mark.parametrize("report_ticks", [0, 1, 3])
@pytest.mark.parametrize("ticks", [1, 6])
def test_reports_and_bits_are_late_by_the_ticks_and_the_ins_is_not(ticks: int, report_ticks: int) -> None:
    late, plain = said(ticks * DT_S, report_ticks=report_ticks), said(report_ticks=report_ticks)
    assert [one.measurement.ins for one in late] == [one.measurement.ins for one in plain]
    assert same([one.measurement.report for one in late[ticks:]], [one.measurement.report for one in plain[:-ticks]])
    assert [one.status for one in late[ticks:]] == [one.status for one in plain[:-ticks]]
    assert {one.status for one in late[:ticks]} == {ByWireStatus()}
    assert len({one.status for one in plain}) > 3, "the bits change"


def test_none_and_none_of_it_are_the_same() -> None:
    assert same(said(0.0), said()) and same(said(0.02, 0.03), said(0.05))


def test_a_part_of_a_tick_counts_as_a_whole_one_for_bits() -> None:
    assert [one.status for one in said(0.031)] == [one.status for one in said(0.04)]


@given(st.lists(STATUS, min_size=1, max_size=20), st.integers(0, 5))
def test_any_status_comes_through(statuses: list[ByWireStatus], ticks: int) -> None:
    state = init_status_delay(ticks * DT_S, DT_S)
    out = []
    for status in statuses:
        state, now = delay_status(state, status)
        out.append(now)
    assert out == [ByWireStatus()] * min(ticks, len(statuses)) + statuses[: max(len(statuses) - ticks, 0)]


def test_every_bit_comes_back_in_its_place() -> None:
    """A field that is added to a status and not to its rows comes back as its default."""
    channels = [ChannelStatus(*(float(10 * k + i) for i in range(len(ChannelStatus._fields)))) for k in (1, 2, 3)]
    status = ByWireStatus(*channels, *(40.0 + i for i in range(len(ByWireStatus._fields) - 3)))
    rows = [0.0] * (2 * STATUS_WIDTH)
    assert pack_status(rows, STATUS_WIDTH, status) == len(rows) and unpack_status(rows, STATUS_WIDTH) == status


def test_no_effect_is_no_delay() -> None:
    assert report_latency(()) == (False, 0.0)
