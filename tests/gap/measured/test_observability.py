"""What a log cannot show is said by link and by channel, and nothing is judged by it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from tests.learn.made_drives import made_drive
from tunefree_hil.base.contracts import Link, Port
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.gap.measured.chain import MeasuredDrive, build_measured_drive
from tunefree_hil.gap.measured.observability import (
    MIN_ACTIVE_S,
    NO_ACTIVE_COMMAND,
    find_idle_channels,
    find_unobservable_links,
    find_unobservable_ports,
    find_untestable_effects,
)
from tunefree_hil.gap.measured.targets import DriveComparison
from tunefree_hil.gap.model.graph import load_catalogue
from tunefree_hil.gap.result_text import reason_text
from tunefree_hil.gap.selection.reasons import Criterion
from tunefree_hil.gap.validation.block_runs import HEADING, POSITION, _can_compare
from tunefree_hil.learn.drives.drive import Drive

pytestmark = pytest.mark.slow
VEHICLE = load_vehicle("mkz_bywire")
STEER = ("command.steer", "report.steer")


@cache
def drive() -> Drive:
    return made_drive(60.0)


def opened(without: tuple[str, ...] = (), enabled: bool = True) -> MeasuredDrive:
    fields = {key: one for key, one in drive().fields.items() if not (without and key.startswith(without))}
    return build_measured_drive(drive()._replace(fields=fields, enabled=drive().enabled & enabled), VEHICLE)


def blind(*drives: MeasuredDrive) -> dict[str, str]:
    links, ports = find_unobservable_links(drives), find_unobservable_ports(drives)
    reasons = find_untestable_effects(load_catalogue(), links, ports)
    places = {place.value for place in (*links, *ports)}
    assert all(reason.criterion is Criterion.UNOBSERVABLE and reason.key in places for reason in reasons.values())
    assert all(reason.name == name for name, reason in reasons.items())
    return {name: reason_text(reason) for name, reason in reasons.items()}


def names(one: MeasuredDrive) -> set[str]:
    return {target.name for target in DriveComparison(one).targets}


def test_a_whole_log_tells_every_channel() -> None:
    assert (
        not find_idle_channels([opened()])
        and not opened().unknown_channels
        and find_unobservable_ports([opened()]) == {}
    )


def test_commands_that_never_acted_show_no_actuator_and_the_motion_is_judged_all_the_same() -> None:
    one = opened(enabled=False)
    assert find_idle_channels([one]) == {"throttle", "brake", "steer"} and not one.unknown_channels
    assert (
        find_unobservable_links([one])[Link.COMMAND_TO_REPORT] == NO_ACTIVE_COMMAND
        and Link.COMMAND_TO_REPORT not in one.unobservable_links
    )
    told = blind(one)
    assert {"steer_dead_time", "throttle_lag", "brake_gain", "steer_report_offset"} - set(told) <= {"brake_gain"}
    assert not {"payload", "grade", "front_stiffness"} & set(told)
    assert {"rate_of_speed", "yaw_rate"} <= names(one) and not {"throttle", "brake", "steer"} & names(one)
    assert blind(one, opened()) == {}, "the other drive shows them"


def test_a_channel_of_which_nothing_is_said_is_no_channel_at_rest() -> None:
    one = opened(STEER)
    assert one.unknown_channels == {"steer"} and not one.inputs.commands[:, 2].any()
    assert not {"yaw_rate", "lateral_beyond_turning", "lateral_accel"} & names(one)
    assert {"rate_of_speed", "throttle", "yaw_vs_ins"} <= names(one)
    told = blind(one)
    assert {name for name, effect in load_catalogue().items() if effect.port in (Port.STEER_A, Port.STEER_B)} <= set(
        told
    )
    assert "the logs hold neither commands nor reports of the steer" in told["steer_lag"] and "throttle_lag" not in told
    assert _can_compare(one, "ins.speed_mps") and not any(
        _can_compare(one, name) for name in (HEADING, POSITION, "ins.yaw_rate_radps")
    )


@pytest.mark.parametrize("pedal", ["throttle", "brake"])
def test_without_a_pedal_no_motion_along_the_car_is_judged(pedal: str) -> None:
    one = opened((f"command.{pedal}", f"report.{pedal}"))
    assert one.unknown_channels == {pedal} and "rate_of_speed" not in names(one) and "yaw_rate" in names(one)
    assert not _can_compare(one, "ins.speed_mps") and _can_compare(one, "report.steer_rad")


def test_a_vehicle_that_has_no_such_channel_misses_nothing() -> None:
    fields = {key: one for key, one in drive().fields.items() if "brake" not in key}
    command, report = (
        {k: v for k, v in some.items() if "brake" not in k} for some in (VEHICLE.command, VEHICLE.report)
    )
    one = build_measured_drive(drive()._replace(fields=fields), replace(VEHICLE, command=command, report=report))
    assert not one.unknown_channels and np.isfinite(one.inputs.commands).all() and "rate_of_speed" in names(one)


def test_what_short_logs_show_together_is_shown() -> None:
    brief = opened()._replace(command_active_s=dict.fromkeys(("throttle", "brake", "steer"), 0.6 * MIN_ACTIVE_S))
    assert blind(brief, brief) == {} and "steer_dead_time" in blind(brief)


def test_a_brake_that_is_only_commanded_and_on_demand_is_at_rest_where_nobody_brakes() -> None:
    fields = {key: one for key, one in drive().fields.items() if "brake" not in key}
    report = {key: one for key, one in VEHICLE.report.items() if "brake" not in key}
    on_demand = replace(VEHICLE, report=report)
    assert not build_measured_drive(drive()._replace(fields=fields), on_demand).unknown_channels
    mute = {key: one for key, one in fields.items() if not key.startswith("command.")}
    assert build_measured_drive(drive()._replace(fields=mute), on_demand).unknown_channels == {"brake"}
