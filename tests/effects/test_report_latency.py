"""Chassis reports that come late, all fields by the same time (bits: tests/plant/test_report_latency.py)."""

from __future__ import annotations

import pytest

from tests.effects.shared import driven, fixes, motions, reports, same, through
from tests.plant.drives import DT_S
from tunefree_hil.base.records import GEAR_DRIVE, GEAR_REVERSE, NAN, Report


@pytest.mark.parametrize("ticks", [1, 7])
def test_every_field_is_late_by_the_ticks_and_the_ins_is_not(ticks: int) -> None:
    with_it = driven("physics", {"report_latency": {"delay_s": ticks * DT_S}})
    without = driven("physics", {})
    assert motions(with_it) == motions(without) and same(fixes(with_it), fixes(without))
    late, plain = reports(with_it), reports(without)
    assert same(late[ticks:], plain[:-ticks])
    assert same(late[:ticks], [plain[0]] * ticks), "before the first report the car was as the first one says"
    assert not same(late, plain)


def test_between_two_ticks_is_a_straight_line_but_for_the_gear() -> None:
    reports_in = [
        Report(speed_mps=float(k), throttle_command_frac=0.1 * k, gear=GEAR_DRIVE if k < 5 else GEAR_REVERSE)
        for k in range(10)
    ]
    out = through("report_latency", {"delay_s": 0.024}, reports_in)
    assert [one.speed_mps for one in out] == pytest.approx([0.0, 0.0, 0.0, 0.6, 1.6, 2.6, 3.6, 4.6, 5.6, 6.6])
    assert [one.throttle_command_frac for one in out[3:]] == pytest.approx([0.06 + 0.1 * k for k in range(7)])
    assert [one.gear for one in out] == [GEAR_DRIVE] * 8 + [GEAR_REVERSE] * 2
    assert all(one.accel_mps2 != one.accel_mps2 for one in out), f"what is absent stays {NAN}"


def test_latencies_add_up() -> None:
    signal = [Report(yaw_rate_radps=0.01 * k * k) for k in range(30)]
    once = through("report_latency", {"delay_s": 0.09}, signal)
    twice = through("report_latency", {"delay_s": 0.05}, through("report_latency", {"delay_s": 0.04}, signal))
    assert same(once, twice)
