"""Signals that contradict each other: each fault planted in a good log is refused with its code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from tests.learn.made_logs import (
    MKZ,
    PEDALS,
    VAN,
    Change,
    car,
    checked,
    drives_of,
    good,
    negated,
    planted,
    refusals,
    scaled,
)
from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.checks.drive_checks import check_drives
from tunefree_hil.learn.checks.problem import raise_refusals
from tunefree_hil.learn.checks.stuck_signals import check_stuck_signals
from tunefree_hil.learn.drives.drive import Drive


def hold_field(name: str, group: str = "report", begin: int = 800, end: int = 2200) -> Change:
    first_values: dict[str, float] = {}

    def change(k: int, records: dict) -> dict:
        record = records[group]
        if not begin <= k < end:
            return records
        value = first_values.setdefault(name, getattr(record, name))
        return records | {group: record._replace(**{name: value})}

    return change


def swapped(k: int, records: dict) -> dict:
    report, command = records["report"], records["command"]
    turned = report._replace(
        throttle_frac=report.brake_frac,
        brake_frac=report.throttle_frac,
        throttle_command_frac=report.brake_command_frac,
        brake_command_frac=report.throttle_command_frac,
    )
    swapped_command = command._replace(throttle_frac=command.brake_frac, brake_frac=command.throttle_frac)
    return records | {"report": turned, "command": swapped_command}


def swapped_commands(k: int, records: dict) -> dict:
    command = records["command"]
    swapped_command = command._replace(throttle_frac=command.brake_frac, brake_frac=command.throttle_frac)
    return records | {"command": swapped_command}


def tapped(k: int, records: dict) -> dict:
    """Both pedals in turn for 0.3 s; the speed follows 0.1 s later, so 0.5 s later it follows the other pedal."""
    phase, rest = k % 60, 0.15
    after = (k - 10) % 60
    speed = 6.0 + 3.0 * 0.01 * (after if after < 30 else 60 - after)
    throttle, brake = (rest + 0.2, rest) if phase < 30 else (rest, rest + 0.2)
    report = records["report"]._replace(
        throttle_frac=throttle, brake_frac=brake, throttle_command_frac=throttle, brake_command_frac=brake,
        speed_mps=speed,
    )  # fmt: skip
    command = records["command"]._replace(throttle_frac=throttle, brake_frac=brake)
    return {"report": report, "ins": records["ins"]._replace(speed_mps=speed), "command": command}


def test_pedals_that_are_only_tapped_are_not_called_swapped(tmp_path: Path) -> None:
    assert car(MKZ).spec.nominal.rest_pedal_frac == 0.15
    problems = checked(tmp_path, MKZ, planted(MKZ, good(MKZ), tapped, [*PEDALS, "report.speed_mps", "ins.speed_mps"]))
    assert "swapped_pedals" not in refusals(problems)


PLANTED: dict[str, tuple[str, Change, str, str, list[str]]] = {
    "yaw_rate_turned": (VAN, negated("yaw_rate_radps"), "wrong_sign", "report.yaw_rate_radps", []),
    "steering_report_turned": (MKZ, negated("steer_rad"), "steer_sign", "report.steer_rad", []),
    "steering_report_turned_van": (VAN, negated("steer_rad"), "steer_sign", "report.steer_rad", []),
    "speed_in_kmh": (VAN, scaled("speed_mps", 3.6), "units", "report.speed_mps", []),
    "yaw_rate_in_degrees": (MKZ, scaled("yaw_rate_radps", 57.3), "units", "report.yaw_rate_radps", []),
    "steering_stuck": (VAN, hold_field("steer_rad"), "stuck", "report.steer_rad", []),
    "throttle_stuck": (MKZ, hold_field("throttle_frac"), "stuck", "report.throttle_frac", []),
    "brake_stuck": (VAN, hold_field("brake_frac"), "stuck", "report.brake_frac", []),
    "speed_stuck": (MKZ, hold_field("speed_mps"), "stuck", "report.speed_mps", []),
    "yaw_rate_stuck": (MKZ, hold_field("yaw_rate_radps"), "stuck", "report.yaw_rate_radps", []),
    "a_wheel_stuck": (VAN, hold_field("wheel_fl_radps"), "stuck", "report.wheel_fl_radps", []),
    "pedals_swapped": (MKZ, swapped, "swapped_pedals", "report.throttle_frac", PEDALS),
    "pedals_swapped_van": (VAN, swapped, "swapped_pedals", "report.throttle_frac", PEDALS),
    "commands_swapped": (MKZ, swapped_commands, "swapped_pedals", "command.throttle_frac", PEDALS),
}


@pytest.mark.parametrize("fault", PLANTED)
def test_what_is_planted_is_refused(fault: str, tmp_path: Path) -> None:
    vehicle, change, code, field, names = PLANTED[fault]
    problems = checked(tmp_path, vehicle, planted(vehicle, good(vehicle), change, names or [field]))
    named = [one for one in problems if one.severity == "refuse" and one.code == code]
    assert field in {one.field for one in named}, problems
    problem = next(one for one in named if one.field == field)
    assert (
        problem.drive == "log0.log"
        and "log0.log" in problem.message
        and field in problem.message
        and "expect" in problem.message
    )
    assert "\n" not in problem.message
    with pytest.raises(InputError, match="these logs cannot be used"):
        raise_refusals(problems)


def stopped(at_rad: float) -> Change:
    """A steering that stops at this angle."""

    def change(k: int, records: dict) -> dict:
        steer = max(-at_rad, min(at_rad, records["report"].steer_rad))
        return records | {"report": records["report"]._replace(steer_rad=steer)}

    return change


@pytest.mark.parametrize(("change", "short"), [
    (stopped(0.4), True), (stopped(0.2), True), (scaled("steer_rad", 0.3), False), (scaled("steer_rad", 0.017), False)
])  # fmt: skip
def test_a_wheel_that_stops_before_its_command_does_has_a_word_of_its_own(
    change: Change, short: bool, tmp_path: Path
) -> None:
    """A stop may be a property of the car; a wrong unit makes small moves too small as well."""
    problems = checked(tmp_path, MKZ, planted(MKZ, good(MKZ), change, ["report.steer_rad"]))
    of_the_command = {one.code for one in problems if one.severity == "refuse" and "command" in one.field}
    assert of_the_command == {"short_of_command" if short else "units"}, problems


def test_a_command_that_stands_in_for_the_report_is_no_witness_of_it(tmp_path: Path) -> None:
    """Without a steering report a car that hardly turns counts as a wrong unit."""
    drives = drives_of(
        tmp_path, MKZ, planted(MKZ, good(MKZ), scaled("yaw_rate_radps", 0.02), ["report.yaw_rate_radps"])
    )
    bare = [
        one._replace(fields={name: values for name, values in one.fields.items() if name != "report.steer_rad"})
        for one in drives
    ]
    problems = check_drives(bare, car(MKZ).spec)
    assert "units" in refusals(problems) and "short_of_command" not in {one.code for one in problems}, problems


@pytest.mark.parametrize("vehicle", [MKZ, VAN])
def test_steering_the_wrong_way_without_an_ins(vehicle: str, tmp_path: Path) -> None:
    """Only steering and one yaw rate, and a folder without wheelbase and steering ratio."""
    spec = car(vehicle).spec
    bare = replace(spec, nominal=replace(spec.nominal, wheelbase_m=None, steer_ratio=None))
    ins = {message.key for message in car(vehicle).codec.telemetry if message.name.startswith("INS_")}
    for change, wrong in ((None, False), (negated("yaw_rate_radps"), True)):
        whole = good(vehicle) if change is None else planted(vehicle, good(vehicle), change, ["report.yaw_rate_radps"])
        rows = [row for row in whole if row.can_id not in ins]
        problems = check_drives(drives_of(tmp_path, vehicle, rows), bare)
        assert ("steer_sign" in refusals(problems)) == wrong, problems


def test_an_answer_that_comes_late_is_not_stuck() -> None:
    """Steps from rest, each followed 30 ms later without noise: just before that the signals differ."""
    ticks = np.arange(6000)
    command = 0.15 + 0.2 * (ticks // 500 % 2)
    echo = 0.15 + 0.2 * (np.maximum(ticks - 3, 0) // 500 % 2)
    speed = 5.0 + 4.0 * np.sin(0.002 * ticks)
    fields = {"command.throttle_frac": command, "report.throttle_command_frac": echo, "report.speed_mps": speed}
    all_rows = np.ones(len(ticks), dtype=bool)
    drive = Drive("made", "", 0.01, fields, dict.fromkeys(fields, all_rows), all_rows)
    assert list(check_stuck_signals(drive)) == []
    echo[1000:3000] = 0.15
    assert [one.field for one in check_stuck_signals(drive)] == ["report.throttle_command_frac"]
