"""A folder with mistakes is refused with every mistake, its key and a way on."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.house import ROOT
from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.dbc.check_vehicle import check_vehicle
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.config.load import load_vehicle

Change = tuple[str, str]
Folder = Callable[..., Path]


@pytest.fixture
def folder(repo: Path, tmp_path: Path) -> Folder:
    """A copy of the MKZ's folder with words replaced in its toml and its DBC."""

    def make(toml: tuple[Change, ...] = (), dbc: tuple[Change, ...] = ()) -> Path:
        copy = tmp_path / "car"
        shutil.copytree(repo / "dbc" / "mkz_bywire", copy)
        for name, changes in (("vehicle.toml", toml), ("vehicle.dbc", dbc)):
            text = (copy / name).read_text()
            for old, new in changes:
                assert old in text, old
                text = text.replace(old, new, 1)
            (copy / name).write_text(text)
        return copy

    return make


def problems_of(folder: Path) -> dict[str, InputError]:
    return {problem.key: problem for problem in check_vehicle(load_vehicle(folder, check=False))}


@pytest.mark.parametrize("name", sorted(path.parent.name for path in (ROOT / "dbc").glob("*/vehicle.toml")))
def test_our_vehicles_have_no_problem(name: str) -> None:
    assert check_vehicle(load_vehicle(name)) == []


@pytest.mark.parametrize(
    ("old", "new", "key", "hint"),
    [
        ('"GYRO"\nsignal = "YAW"', '"GYRO"\nsignal = "YAWW"', "report.yaw_rate_radps.signal", "YAW"),
        ('message = "GYRO"', 'message = "GYRRO"', "report.yaw_rate_radps.message", "GYRO"),
        ('counter = "COUNT"', 'counter = "COUNTER"', "command.throttle_frac.counter", "COUNT"),
        ('enable = "EN"', 'enable = "ENABLE"', "command.throttle_frac.enable", "EN"),
        ('counter = "COUNT"', 'counter = "EN"', "command.throttle_frac.counter", "2 to 16 bits"),
        ('counter = "COUNT"', 'counter = "PCMD"', "command.throttle_frac.counter", "role"),
        ("{ CMD_TYPE = 1 }", "{ CMD_TYP = 1 }", "command.throttle_frac.constants.CMD_TYP", "CMD_TYPE"),
        ("{ CMD_TYPE = 1 }", "{ CMD_TYPE = 16 }", "command.throttle_frac.constants.CMD_TYPE", "0 to 15"),
        ("{ CMD_TYPE = 1 }", "{ PCMD = 0.5 }", "command.throttle_frac.constants.PCMD", "remove"),
        ('signal = "WDCSRC", active = 4', 'signal = "WDCSRC", active = 16', "state.watchdog[4].active", "0 to 15"),
        ('signal = "FLTCAL"', 'signal = "FLTCALL"', "state.fault[12].signal", "FLTCAL"),
        ('signal = "DRIVER"', 'signal = "PI"', "state.driver[0]", "one meaning"),
        ("[extra.MISC_CMD]", "[extra.MISC_CMDS]", "extra.MISC_CMDS.message", "MISC_CMD"),
        ('counter = "COUNT"', 'e2e = { profile = "P9" }', "command.throttle_frac.e2e.profile", "none"),
        ('"PC"\nperiod_ms = 20', '"PC"\nperiod_ms = 10', "report.throttle_input_frac.period_ms", "one"),
        ('"PC"\nperiod_ms = 20', '"PO"\nperiod_ms = 20', "report.throttle_frac", "absent"),
        ('"YAW"\nperiod_ms = 10', '"YAW"\nperiod_ms = 30', "report.yaw_rate_radps.period_ms", "same"),
        ('"ANGLE"\nscale = 0.017453292519943295', '"ANGLE"\nscale = 1.0', "report.steer_rad.scale", "0.0174532925"),
        ('"STEERING_REPORT"\nsignal = "SPEED"', '"GYRO"\nsignal = "ROLL"', "report.speed_mps.scale", "unit"),
        ('"THROTTLE_CMD"\nsignal = "PCMD"', '"THROTTLE_REPORT"\nsignal = "PI"', "command.throttle_frac", "one way"),
    ],
)  # fmt: skip
def test_a_slip_in_the_toml_is_found(folder: Folder, old: str, new: str, key: str, hint: str) -> None:
    found = problems_of(folder(toml=((old, new),)))
    assert key in found, found.keys()
    assert hint in found[key].hint and found[key].file.endswith("vehicle.toml")


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        (" SG_ PC : 16|16", " SG_ PC : 12|16", "message BRAKE_REPORT", "overlap"),
        ("BO_ 108 GYRO: 4", "BO_ 108 GYRO: 3", "message GYRO", "ends in byte 3"),
        (" SG_ COUNT : 56|8@1+", " SG_ COUNT : 56|8@1-", "command.brake_frac.counter", "signed"),
        (" SG_ YAW : 16|16@1- (0.0002,0)", " SG_ YAW : 16|16@1- (0,0)", "report.yaw_rate_radps.signal", "one value"),
        ("BO_ 108 GYRO", "BO_ 107 GYRO", "message GYRO", "id of ACCEL"),
        ("32|16@1- (0.01,0) [-180|180]", "32|16@1- (0.01,0) [-90|90]", "ins.heading_rad.signal", "turn"),
    ],
)  # fmt: skip
def test_a_slip_in_the_dbc_is_found(folder: Folder, old: str, new: str, key: str, words: str) -> None:
    found = problems_of(folder(dbc=((old, new),)))
    assert key in found and words in found[key].message, {k: str(v) for k, v in found.items()}


def test_a_codec_lists_all_of_them_at_once(folder: Folder) -> None:
    changed = folder(
        toml=(('message = "GYRO"', 'message = "GYRRO"'), ('enable = "EN"', 'enable = "ENABLE"')),
        dbc=((" SG_ PC : 16|16", " SG_ PC : 12|16"),),
    )
    with pytest.raises(InputError) as caught:
        Codec(load_vehicle(changed))
    text = str(caught.value)
    assert "3 things" in text and "GYRRO" in text and "'ENABLE'" in text and "overlap" in text


def test_a_can_fd_message_needs_a_data_bitrate(folder: Folder) -> None:
    long = (("BO_ 108 GYRO: 4", "BO_ 108 GYRO: 12"),)
    assert "FD" in problems_of(folder(dbc=long))["data_bitrate"].message


def test_what_is_no_dbc_is_said_with_its_line(folder: Folder) -> None:
    with pytest.raises(InputError, match="line 9"):
        Codec(load_vehicle(folder(dbc=(("BO_ 96 BRAKE_CMD: 8 HOST", "BO_ 96 BRAKE_CMD 8 HOST"),))))


def test_a_missing_dbc_is_said(folder: Folder) -> None:
    with pytest.raises(InputError, match="no such file") as caught:
        Codec(load_vehicle(folder(toml=(('["vehicle.dbc"]', '["other.dbc"]'),))))
    assert caught.value.file.endswith("other.dbc")


def test_a_range_that_the_bits_cannot_reach_is_not_believed(folder: Folder) -> None:
    """[0|65535] on a signed 16-bit signal is a common slip: negative angles must still get through."""
    codec = Codec(
        load_vehicle(
            folder(dbc=((" SG_ SCMD : 0|16@1- (0.1,0) [-470|470]", " SG_ SCMD : 0|16@1- (0.1,0) [0|6553.5]"),))
        )
    )
    signal = codec.by_name["STEERING_CMD"].signals["SCMD"]
    assert (signal.raw_low, signal.raw_high) == (-32768, 32767)


def test_a_multiplexed_message_is_refused(folder: Folder) -> None:
    changes = ((" SG_ ROLL : 0|16@1-", " SG_ ROLL M : 0|16@1-"), (" SG_ YAW : 16|16@1-", " SG_ YAW m0 : 16|16@1-"))
    assert "multiplexed" in problems_of(folder(dbc=changes))["message GYRO"].message


def test_a_state_alone_makes_a_message(folder: Folder) -> None:
    """A message that only [state] speaks of is telemetry; its period is the DBC's."""
    gear = '[report.gear]\nmessage = "GEAR_REPORT"\nsignal = "STATE"\nperiod_ms = 50\nassumed = "period not published"'
    moved = folder(toml=((gear, ""), ("absent = []", 'absent = ["report.gear"]')))
    message = Codec(load_vehicle(moved)).by_name["GEAR_REPORT"]
    assert (message.kind, message.period_ticks, message.fields, message.bywire) == ("telemetry", 5, (), ("gear",))


def test_the_period_of_a_state_alone_must_be_ticks(folder: Folder) -> None:
    gear = '[report.gear]\nmessage = "GEAR_REPORT"\nsignal = "STATE"\nperiod_ms = 50\nassumed = "period not published"'
    cycle = ('BA_ "GenMsgCycleTime" BO_ 103 50;', 'BA_ "GenMsgCycleTime" BO_ 103 25;')
    moved = folder(toml=((gear, ""), ("absent = []", 'absent = ["report.gear"]')), dbc=(cycle,))
    said = [str(one) for one in problems_of(moved).values() if "GEAR_REPORT" in one.message]
    assert said and all("every 25 ms, no multiple of the tick" in one and "[extra.GEAR_REPORT]" in one for one in said)


@pytest.mark.parametrize(("declared", "modulus"), [("[0|14]", 15), ("[0|255]", 256), ("[0|0]", 256), ("[0|1]", 256)])
def test_a_counter_rolls_over_where_the_dbc_says(folder: Folder, declared: str, modulus: int) -> None:
    count = " SG_ COUNT : 56|8@1+ (1,0) "
    codec = Codec(load_vehicle(folder(dbc=((f"{count}[0|255]", f"{count}{declared}"),))))
    assert codec.by_name["BRAKE_CMD"].counter_modulus == modulus
