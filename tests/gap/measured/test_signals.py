"""A measured signal on every tick: gaps, signals that come seldom, an INS that says next to nothing of a drive."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.gap.measured.signals import drop_sparse_ins, find_valid_command_rows, read_signals, signal_from_values
from tunefree_hil.learn.drives.drive import Drive

DT_S, TICKS = 0.01, 3000
T = DT_S * np.arange(TICKS)


def drive(ins_until: int, every: int = 1) -> Drive:
    """A speed of wheels on every tick, and one of an INS on every so many, up to a tick."""
    fields = {"report.speed_mps": np.sin(T), "ins.speed_mps": np.sin(T), "ins.yaw_rate_radps": np.cos(T)}
    ins = (np.arange(TICKS) < ins_until) & (np.arange(TICKS) % every == 0)
    fresh = {name: ins if name.startswith("ins.") else np.ones(TICKS, dtype=bool) for name in fields}
    return Drive("made", f"sha256:{1:064x}", DT_S, fields, fresh, np.ones(TICKS, dtype=bool))


def test_an_ins_that_covers_little_of_a_drive_is_left_out_with_a_word() -> None:
    little = read_signals(drive(ins_until=900), 0.0)
    alone, words = drop_sparse_ins(little, "made")
    assert set(alone) == {"report.speed_mps", "ins.yaw_rate_radps"} and "30%" in words[0], (
        "nobody else tells the yaw rate"
    )
    both, _ = drop_sparse_ins(little | {"report.yaw_rate_radps": little["report.speed_mps"]}, "made")
    assert set(both) == {"report.speed_mps", "report.yaw_rate_radps"}
    most = read_signals(drive(ins_until=2100), 0.0)
    assert drop_sparse_ins(most, "made") == (most, ())


def test_of_an_ins_that_loses_its_yaw_rate_that_alone_is_left_out() -> None:
    all_ = read_signals(drive(TICKS), 0.0)
    few = read_signals(drive(ins_until=900), 0.0)["ins.yaw_rate_radps"]
    some = all_ | {"report.yaw_rate_radps": all_["report.speed_mps"], "ins.yaw_rate_radps": few}
    kept, words = drop_sparse_ins(some, "made")
    assert set(some) - set(kept) == {"ins.yaw_rate_radps"} and "a yaw rate in 30%" in words[0]


@pytest.mark.parametrize("late", [0.0, 2.5, 7.0])
def test_a_simulation_that_is_right_is_missed_by_nothing_however_seldom_a_sensor_speaks(late: float) -> None:
    """2 Hz seen ten times a second: a straight line between two values is off by a tenth."""
    true = np.sin(2.0 * np.pi * 2.0 * T)
    seen = drive(TICKS, every=10)
    earlier = np.sin(2.0 * np.pi * 2.0 * (T - late * DT_S))  # what an INS that is late says
    seen = seen._replace(fields={**seen.fields, "ins.speed_mps": earlier})
    signal = read_signals(seen, late)["ins.speed_mps"]
    inside = slice(20, -20)
    assert np.abs(signal.values - true)[inside].max() > 0.1
    assert signal.values[inside] == pytest.approx(signal.resample(true)[inside], abs=0.02)
    assert np.array_equal(signal._replace(interval_rows=1.0).resample(true), true)


def test_a_gap_is_no_place_to_look() -> None:
    fresh = np.arange(TICKS) % 2 == 0
    fresh[1000:1100] = False
    signal = signal_from_values(np.sin(T), fresh, DT_S)
    assert np.flatnonzero(~signal.is_valid).tolist() == [*range(999, 1100), 2999]
    assert np.array_equal(find_valid_command_rows({"a": signal}, ("b", "a"), TICKS), signal.is_valid)
    assert find_valid_command_rows({}, ("a",), TICKS).all()


def test_a_message_that_is_sent_on_demand_has_no_gap_between_two_demands() -> None:
    braking = signal_from_values(np.sin(T), T % 10.0 < 3.0, DT_S)
    assert not braking.is_valid.all() and find_valid_command_rows({"a": braking}, ("a",), TICKS).all()
    once = signal_from_values(np.sin(T), T < 12.0, DT_S)
    assert not find_valid_command_rows({"a": once}, ("a",), TICKS).all(), (
        "it ends, and nobody knows what was asked then"
    )


@pytest.mark.parametrize(("late", "every"), [(0.0, 1), (0.2, 1), (0.5, 1), (5.0, 10), (2.5, 10)])
def test_a_sensor_is_as_loud_as_what_it_told_however_late_it_is(late: float, every: int) -> None:
    """Half a row earlier each value is a mean of two, which is quieter."""
    made = drive(TICKS, every)
    noise = 0.05 * np.random.default_rng(1).standard_normal(TICKS)
    made = made._replace(fields={**made.fields, "ins.speed_mps": np.sin(0.2 * T) + noise})
    signal = read_signals(made, late)["ins.speed_mps"]
    assert signal.noise == pytest.approx(0.05, rel=0.15)
    rows = np.flatnonzero(signal.fresh)[5:-5]
    right = signal.sample_at(np.sin(0.2 * (T + late * DT_S)), rows)  # the car is ahead of what the INS says of it
    assert np.std(right - signal.received[rows]) == pytest.approx(0.05, rel=0.15)
