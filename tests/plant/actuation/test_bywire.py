"""The by-wire unit's rules, one by one (docs/reference/by_wire.md)."""

from __future__ import annotations

from typing import Any

import pytest

from tunefree_hil.base.records import GEAR_DRIVE, GEAR_NEUTRAL, GEAR_PARK
from tunefree_hil.plant.actuation.bywire import (
    CAUSES,
    ByWireInput,
    ByWireOutput,
    ByWireParams,
    ReceivedChannel,
    ReceivedCommand,
    bywire,
)
from tunefree_hil.plant.types import Driver


class Bench:
    """A unit and its last output; each tick hears the three channels enabled unless told otherwise."""

    def __init__(self, params: ByWireParams = ByWireParams()) -> None:  # noqa: B008 - a frozen record
        self.block = bywire(params)
        self.state = self.block.init(params, 0.01)
        self.speed_mps, self.steer_rad = 5.0, 0.0

    def tick(self, heard: ReceivedCommand | None = None, driver: Driver | None = None, n: int = 1) -> ByWireOutput:
        for _ in range(n):
            x = ByWireInput(heard or said(), driver or Driver(), self.speed_mps, self.steer_rad)
            self.state, self.out = self.block.step(self.block.params, self.state, x, 0.01)
        return self.out


def said(throttle: float = 0.25, brake: float = 0.15, steer: float = 0.5, **more: Any) -> ReceivedCommand:
    """Fresh enabled frames; `more` changes a channel (throttle_ignore=1.0) or the record (gear=...)."""
    fields: dict[str, dict[str, float]] = {"throttle": {}, "brake": {}, "steer": {}}
    record = {}
    for key, value in more.items():
        channel, _, field = key.partition("_")
        if channel in fields:
            fields[channel][field] = value
        else:
            record[key] = value
    channels = {
        name: ReceivedChannel(**{"value": value, "enable": 1.0, "fresh": 1.0, **fields[name]})
        for name, value in (("throttle", throttle), ("brake", brake), ("steer", steer))
    }
    return ReceivedCommand(**channels, **record)


NOTHING = ReceivedCommand()


def enabled(out: ByWireOutput) -> list[float]:
    return [out.status.throttle.enabled, out.status.brake.enabled, out.status.steer.enabled]


def test_disabled_the_pedals_are_the_drivers_and_the_steering_stays() -> None:
    bench = Bench()
    out = bench.tick(NOTHING, Driver(throttle_frac=0.2, brake_frac=0.17))
    assert (out.command.throttle_frac, out.command.brake_frac, out.command.steer_rad) == (0.2, 0.17, 0.0)
    out = bench.tick(said(throttle_enable=0.0, brake_enable=0.0, steer_enable=0.0, steer=2.0))
    assert enabled(out) == [0.0, 0.0, 0.0] and out.command.steer_rad == 0.0
    assert out.status.watchdog_cause == 0.0


def test_enabled_the_commands_pass() -> None:
    out = Bench().tick(said(0.25, 0.15, 0.5))
    assert enabled(out) == [1.0, 1.0, 1.0]
    assert out.command[:4] == (0.25, 0.15, 0.5, GEAR_DRIVE)


def test_channels_are_enabled_one_by_one() -> None:
    out = Bench().tick(said(throttle_enable=0.0))
    assert enabled(out) == [0.0, 1.0, 1.0] and out.command.throttle_frac == 0.15


def test_commands_are_kept_within_their_range() -> None:
    out = Bench().tick(said(0.95, 0.0, -9.0))
    assert out.command[:3] == (0.80, 0.15, -8.2)


def test_brake_ramp() -> None:
    bench = Bench()
    assert bench.tick(said(brake=0.50)).command.brake_frac == pytest.approx(0.35)
    assert bench.tick(said(brake=0.50)).command.brake_frac == pytest.approx(0.50)
    assert bench.tick(said(brake=0.15)).command.brake_frac == pytest.approx(0.30)


def test_the_stronger_foot_wins_below_the_override() -> None:
    out = Bench().tick(said(0.20), Driver(throttle_frac=0.28))
    assert out.command.throttle_frac == 0.28
    assert Bench().tick(said(0.20, throttle_ignore=1.0), Driver(throttle_frac=0.28)).command.throttle_frac == 0.20
    assert Bench().tick(said(brake=0.16), Driver(brake_frac=0.21)).command.brake_frac == 0.21


@pytest.mark.parametrize(
    ("driver", "channel", "ticks"),
    [
        (Driver(brake_frac=0.23), "brake", 10),
        (Driver(throttle_frac=0.31), "throttle", 10),
        (Driver(steer_hold=1.0), "steer", 10),
        (Driver(steer_torque_nm=-5.0), "steer", 10),
    ],
)
def test_override_takes_100_ms_latches_and_disables_everything(driver: Driver, channel: str, ticks: int) -> None:
    bench = Bench()
    bench.tick()
    out = bench.tick(driver=driver, n=ticks - 1)
    assert enabled(out) == [1.0, 1.0, 1.0]
    out = bench.tick(driver=driver)
    assert enabled(out) == [0.0, 0.0, 0.0] and getattr(out.status, channel).override == 1.0
    out = bench.tick(n=20)
    assert enabled(out) == [0.0, 0.0, 0.0], "latched after the driver let go"
    assert out.status.watchdog_cause == 0.0
    out = bench.tick(said(**{f"{channel}_clear": 1.0}))
    assert enabled(out) == [1.0, 1.0, 1.0] and getattr(out.status, channel).override == 0.0


def test_below_the_override_level_nothing_happens() -> None:
    bench = Bench()
    out = bench.tick(driver=Driver(throttle_frac=0.30, brake_frac=0.22), n=200)
    assert enabled(out) == [1.0, 1.0, 1.0]
    assert out.status.brake.driver == out.status.throttle.driver == 1.0


def test_driver_bit_takes_20_ms() -> None:
    bench = Bench()
    foot = Driver(brake_frac=0.19)
    assert [bench.tick(driver=foot).status.brake.driver for _ in range(3)] == [0.0, 1.0, 1.0]
    assert bench.tick().status.brake.driver == 0.0


def test_a_short_tap_does_not_override() -> None:
    bench = Bench()
    for _ in range(5):
        bench.tick(driver=Driver(brake_frac=0.3), n=9)
        out = bench.tick()
    assert enabled(out) == [1.0, 1.0, 1.0]


def test_ignore_keeps_the_channel_from_being_overridden() -> None:
    out = Bench().tick(said(brake_ignore=1.0), Driver(brake_frac=0.4), n=50)
    assert enabled(out) == [1.0, 1.0, 1.0] and out.status.brake.driver == 1.0


def test_a_driver_who_keeps_pressing_is_not_cleared_for_long() -> None:
    bench = Bench()
    foot = Driver(brake_frac=0.3)
    bench.tick(driver=foot, n=12)
    bench.tick(said(brake_clear=1.0), foot)
    assert enabled(bench.tick(driver=foot)) == [0.0, 0.0, 0.0]


def test_gear_override() -> None:
    bench = Bench()
    bench.tick()
    out = bench.tick(driver=Driver(gear_override=1.0))
    assert enabled(out) == [0.0, 0.0, 0.0] and out.status.gear_override == 1.0
    assert enabled(bench.tick(n=5)) == [0.0, 0.0, 0.0]
    assert enabled(bench.tick(said(gear_clear=1.0))) == [1.0, 1.0, 1.0]


def test_steering_stays_where_it_was_when_disabled() -> None:
    bench = Bench()
    bench.tick(said(steer=2.0))
    bench.steer_rad = 1.3
    out = bench.tick(driver=Driver(gear_override=1.0))
    bench.steer_rad = 1.4
    assert out.command.steer_rad == 1.3 and bench.tick(said(steer=0.0)).command.steer_rad == 1.3


@pytest.mark.parametrize("channel", ["throttle", "brake", "steer"])
def test_time_out_of_100_ms_brakes_until_a_power_cycle(channel: str) -> None:
    bench = Bench()
    bench.tick()
    silent = said(**{f"{channel}_fresh": 0.0})
    out = bench.tick(silent, n=9)
    assert enabled(out) == [1.0, 1.0, 1.0]
    out = bench.tick(silent)
    assert getattr(out.status, channel).timeout == 1.0
    assert out.status.watchdog_cause == CAUSES[f"{channel}_timeout"] and out.status.watchdog_braking == 1.0
    assert enabled(out) == [0.0, 0.0, 0.0]
    out = bench.tick(said(0.5, brake_clear=1.0, throttle_clear=1.0, steer_clear=1.0), n=5)
    assert out.command.brake_frac == pytest.approx(0.30) and out.command.throttle_frac == 0.15
    assert out.status.watchdog_cause == CAUSES[f"{channel}_timeout"]
    bench.state = bench.block.init(bench.block.params, 0.01)
    assert enabled(bench.tick()) == [1.0, 1.0, 1.0]


def test_slow_commands_are_fine() -> None:
    bench = Bench()
    for _ in range(20):
        bench.tick()
        out = bench.tick(NOTHING, n=8)
    assert enabled(out) == [1.0, 1.0, 1.0] and out.command.throttle_frac == 0.25


def test_never_enabled_never_times_out() -> None:
    out = Bench().tick(NOTHING, n=500)
    assert out.status.watchdog_cause == 0.0 and out.status.brake.timeout == 0.0


@pytest.mark.parametrize("channel", ["throttle", "brake", "steer"])
def test_counter_that_stands_still(channel: str) -> None:
    bench = Bench()
    bench.tick()
    out = bench.tick(said(**{f"{channel}_counter_ok": 0.0}))
    assert getattr(out.status, channel).counter_fault == 1.0
    assert out.status.watchdog_cause == CAUSES[f"{channel}_counter"]
    assert bench.tick(n=30).status.watchdog_braking == 1.0


def test_counter_does_not_matter_for_clear_frames_or_where_nobody_checks() -> None:
    out = Bench().tick(said(brake_clear=1.0, brake_counter_ok=0.0))
    assert out.status.watchdog_cause == 0.0
    out = Bench(ByWireParams(check_counter=0.0)).tick(said(brake_counter_ok=0.0))
    assert out.status.watchdog_cause == 0.0 and enabled(out) == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("channel", ["throttle", "brake", "steer"])
def test_disabled_while_in_gear(channel: str) -> None:
    bench = Bench()
    bench.speed_mps = 0.0
    bench.tick()
    out = bench.tick(said(**{f"{channel}_enable": 0.0}))
    assert out.status.watchdog_cause == CAUSES[f"{channel}_disabled"]


def test_disabled_in_park_is_fine_and_moving_in_neutral_is_not() -> None:
    for gear, speed_mps, wrong in ((GEAR_PARK, 0.0, False), (GEAR_NEUTRAL, 3.0, True)):
        bench = Bench()
        bench.speed_mps = speed_mps
        bench.tick(said(gear=gear), n=2)
        out = bench.tick(said(brake_enable=0.0))
        assert (out.status.watchdog_cause > 0.0) is wrong


def test_gears() -> None:
    bench = Bench()
    assert bench.tick(said(gear=GEAR_PARK)).command.gear == GEAR_DRIVE, "not while it moves"
    assert bench.tick(said(gear=GEAR_NEUTRAL)).command.gear == GEAR_NEUTRAL
    bench.speed_mps = 0.0
    assert bench.tick(said(gear=GEAR_PARK)).command.gear == GEAR_PARK
    assert bench.tick(said()).command.gear == GEAR_PARK, "stays without a wish"


def test_a_scripted_cause() -> None:
    out = Bench().tick(driver=Driver(fault_cause=CAUSES["steer_report_timeout"]))
    assert out.status.watchdog_cause == CAUSES["steer_report_timeout"] and enabled(out) == [0.0, 0.0, 0.0]


def test_causes_are_14_different_codes() -> None:
    assert sorted(CAUSES.values()) == [float(i) for i in range(14)]
    assert CAUSES["brake_counter"] == 2.0 and CAUSES["steer_report_timeout"] == 13.0
