"""A measured signal on every tick: gaps, signals that come seldom, an INS that says next to nothing of a drive."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.gap.signals import all_there, as_told, carried, signals_of
from tunefree_hil.learn.drives import Drive

DT_S, TICKS = 0.01, 3000
T = DT_S * np.arange(TICKS)


def drive(ins_until: int, every: int = 1) -> Drive:
    """A speed of wheels on every tick, and one of an INS on every so many, up to a tick."""
    fields = {"report.speed_mps": np.sin(T), "ins.speed_mps": np.sin(T), "ins.yaw_rate_radps": np.cos(T)}
    ins = (np.arange(TICKS) < ins_until) & (np.arange(TICKS) % every == 0)
    fresh = {name: ins if name.startswith("ins.") else np.ones(TICKS, dtype=bool) for name in fields}
    return Drive("made", f"sha256:{1:064x}", DT_S, fields, fresh, np.ones(TICKS, dtype=bool))


def test_an_ins_that_covers_little_of_a_drive_is_left_out_with_a_word() -> None:
    few, words = signals_of(drive(ins_until=900), 0.0)
    assert set(few) == {"report.speed_mps"} and "30%" in words[0]
    most, none = signals_of(drive(ins_until=2100), 0.0)
    assert {"ins.speed_mps", "ins.yaw_rate_radps"} < set(most) and not none


@pytest.mark.parametrize("late", [0.0, 2.5, 7.0])
def test_a_simulation_that_is_right_is_missed_by_nothing_however_seldom_a_sensor_speaks(late: float) -> None:
    """2 Hz seen ten times a second: a straight line between two values is off by a tenth."""
    true = np.sin(2.0 * np.pi * 2.0 * T)
    seen = drive(TICKS, every=10)
    earlier = np.sin(2.0 * np.pi * 2.0 * (T - late * DT_S))  # what an INS that is late says
    seen = seen._replace(fields={**seen.fields, "ins.speed_mps": earlier})
    signal = signals_of(seen, late)[0]["ins.speed_mps"]
    inside = slice(20, -20)
    assert np.abs(signal.values - true)[inside].max() > 0.1
    assert signal.values[inside] == pytest.approx(signal.as_seldom(true)[inside], abs=0.02)
    assert np.array_equal(signal._replace(every=1.0).as_seldom(true), true)


def test_a_gap_is_no_place_to_look() -> None:
    fresh = np.arange(TICKS) % 2 == 0
    fresh[1000:1100] = False
    signal = as_told(np.sin(T), fresh, DT_S)
    assert np.flatnonzero(~signal.there).tolist() == [*range(999, 1100), 2999]
    assert np.array_equal(carried({"a": signal}, ("b", "a"), TICKS), signal.there)
    assert carried({}, ("a",), TICKS).all()


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.integers(0, 9), st.integers(0, 9))
def test_all_there_is_what_it_says(there: list[bool], before: int, behind: int) -> None:
    found = all_there(np.array(there), before, behind)
    for i, one in enumerate(found):
        begin, end = i - before, i + behind + 1
        assert one == (begin >= 0 and end <= len(there) and all(there[begin:end]))
