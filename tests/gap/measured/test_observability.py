"""What a log cannot show is said by link and by channel, and nothing is judged by it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from tests.learn.made_drives import made_drive
from tunefree_hil.base.contracts import Link, Port
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.gap.measured.chain import Opened, open_chain
from tunefree_hil.gap.measured.observability import (
    LEAST_ACTED_S,
    NOTHING_ACTED,
    idle_channels,
    lost_links,
    silent_ports,
    untold,
)
from tunefree_hil.gap.measured.targets import Compared
from tunefree_hil.gap.model.graph import effects
from tunefree_hil.gap.validation.holdout import HEADING, POSITION, _has
from tunefree_hil.learn.drives.drive import Drive

pytestmark = pytest.mark.slow
VEHICLE = load_vehicle("mkz_bywire")
STEER = ("command.steer", "report.steer")


@cache
def drive() -> Drive:
    return made_drive(60.0)


def opened(without: tuple[str, ...] = (), enabled: bool = True) -> Opened:
    fields = {key: one for key, one in drive().fields.items() if not (without and key.startswith(without))}
    return open_chain(drive()._replace(fields=fields, enabled=drive().enabled & enabled), VEHICLE)


def blind(*drives: Opened) -> dict[str, str]:
    return untold(effects(), lost_links(drives), silent_ports(drives))


def names(one: Opened) -> set[str]:
    return {target.name for target in Compared(one).targets}


def test_a_whole_log_tells_every_channel() -> None:
    assert not idle_channels([opened()]) and not opened().unknown and silent_ports([opened()]) == {}


def test_commands_that_never_acted_show_no_actuator_and_the_motion_is_judged_all_the_same() -> None:
    one = opened(enabled=False)
    assert idle_channels([one]) == {"throttle", "brake", "steer"} and not one.unknown
    assert lost_links([one])[Link.COMMAND_TO_REPORT] == NOTHING_ACTED and Link.COMMAND_TO_REPORT not in one.lost
    told = blind(one)
    assert {"steer_dead_time", "throttle_lag", "brake_gain", "steer_report_offset"} - set(told) <= {"brake_gain"}
    assert not {"payload", "grade", "front_stiffness"} & set(told)
    assert {"rate_of_speed", "yaw_rate"} <= names(one) and not {"throttle", "brake", "steer"} & names(one)
    assert blind(one, opened()) == {}, "the other drive shows them"


def test_a_channel_of_which_nothing_is_said_is_no_channel_at_rest() -> None:
    one = opened(STEER)
    assert one.unknown == {"steer"} and not one.inputs.commands[:, 2].any()
    assert not {"yaw_rate", "lateral_beyond_turning", "lateral_accel"} & names(one)
    assert {"rate_of_speed", "throttle", "yaw_vs_ins"} <= names(one)
    told = blind(one)
    assert {name for name, effect in effects().items() if effect.port in (Port.STEER_A, Port.STEER_B)} <= set(told)
    assert "neither commands nor reports say what the steer did" in told["steer_lag"] and "throttle_lag" not in told
    assert _has(one, "ins.speed_mps") and not any(_has(one, name) for name in (HEADING, POSITION, "ins.yaw_rate_radps"))


@pytest.mark.parametrize("pedal", ["throttle", "brake"])
def test_without_a_pedal_no_motion_along_the_car_is_judged(pedal: str) -> None:
    one = opened((f"command.{pedal}", f"report.{pedal}"))
    assert one.unknown == {pedal} and "rate_of_speed" not in names(one) and "yaw_rate" in names(one)
    assert not _has(one, "ins.speed_mps") and _has(one, "report.steer_rad")


def test_a_vehicle_that_has_no_such_channel_misses_nothing() -> None:
    fields = {key: one for key, one in drive().fields.items() if "brake" not in key}
    command, report = (
        {k: v for k, v in some.items() if "brake" not in k} for some in (VEHICLE.command, VEHICLE.report)
    )
    one = open_chain(drive()._replace(fields=fields), replace(VEHICLE, command=command, report=report))
    assert not one.unknown and np.isfinite(one.inputs.commands).all() and "rate_of_speed" in names(one)


def test_what_short_logs_show_together_is_shown() -> None:
    brief = opened()._replace(acted_s=dict.fromkeys(("throttle", "brake", "steer"), 0.6 * LEAST_ACTED_S))
    assert blind(brief, brief) == {} and "steer_dead_time" in blind(brief)


def test_a_brake_that_is_only_commanded_and_on_demand_is_at_rest_where_nobody_brakes() -> None:
    fields = {key: one for key, one in drive().fields.items() if "brake" not in key}
    report = {key: one for key, one in VEHICLE.report.items() if "brake" not in key}
    on_demand = replace(VEHICLE, report=report)
    assert not open_chain(drive()._replace(fields=fields), on_demand).unknown
    mute = {key: one for key, one in fields.items() if not key.startswith("command.")}
    assert open_chain(drive()._replace(fields=mute), on_demand).unknown == {"brake"}
