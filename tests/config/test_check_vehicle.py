"""What a vehicle.toml can say wrongly by itself."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.check_vehicle import check_fields
from tunefree_hil.config.load import load_vehicle


def changed(repo: Path, tmp_path: Path, *changes: tuple[str, str], vehicle: str = "mkz_bywire") -> Path:
    text = (repo / "dbc" / vehicle / "vehicle.toml").read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    (tmp_path / "vehicle.toml").write_text(text)
    return tmp_path


@pytest.mark.parametrize(
    ("old", "new", "key", "words", "hint"),
    [
        ("[report.gear]", "[report.gears]", "report.gears", "no such record field", "gear"),
        ('"BO", cause = "output"', '"BO", cause = "lamp"', "state.brake_light[2].cause", "lamp", "output"),
        ('5, cause = "vehicle"', '5, cause = "engine"', "state.gear_reject[1].cause", "engine", "vehicle"),
        ("[report.gear]", "[report.gears]", "report.gear", "neither mapped nor", "absent"),
        ("absent = []", 'absent = ["report.gear"]', "report.gear", "mapped and listed", "remove"),
        ("absent = []", 'absent = ["report.gaer"]', "absent[0]", "no such record field", "report.gear"),
        ("period_ms = 50", "period_ms = 0", "extra.MISC_CMD.period_ms", "it is 0", "tick_ms = 10"),
        ('"PC"\nperiod_ms = 20', '"PC"\nperiod_ms = 25', "report.throttle_command_frac.period_ms", "25", "tick"),
        ('signal = "PO"\nperiod_ms = 20', 'signal = "PO"', "report.throttle_frac.period_ms", "it is 0", "multiple"),
        ("timeout_ms = 100", "timeout_ms = 95", "command.throttle_frac.timeout_ms", "95", "tick_ms"),
        ('signal = "SCMD"', "", "command.steer_rad.signal", "either", "signals"),
        ('"FRONT_LEFT", "FRONT_RIGHT", ', "", "report.wheel_speed_radps.signal", "four", "FL"),
        ('signal = "SPEED"', 'signal = ["SPEED", "SPEED"]', "report.speed_mps.signal", "got a list", "signals"),
        ("scale = -1.0", "scale = 0.0", "report.lateral_accel_mps2.scale", "0", "SI"),
        ("tick_ms = 10\n", "tick_ms = 0\n", "tick_ms", "not above 0", "above 0"),
        ("bitrate = 500_000", "bitrate = -1", "bitrate", "not above 0", ""),
        ('dbc = ["vehicle.dbc"]', "dbc = []", "dbc", "empty", "DBC"),
        ("mass_kg = 2080.0", "mass_kg = 0.0", "nominal.mass_kg", "not above 0", ""),
        ("steer_rad = 8.20305", "steer_rad = -8.2", "limits.steer_rad", "not above 0", ""),
        ("[-6.0, 2.0]", "[2.0, -6.0]", "limits.accel_mps2", "[low, high]", ""),
        ("[latency.steer]", "[latency.steering]", "latency.steering", "no such actuator", "steer"),
        ("dead_time_s = 0.1", "dead_time_s = -0.1", "latency.steer.dead_time_s", "below 0", "seconds"),
        ("latency_s = 0.002", "latency_s = -0.002", "ins_frame.latency_s", "below 0", ""),
        ('"PO"\nperiod_ms = 20', '"PO"\nperiod_ms = 3600020', "report.throttle_frac.period_ms", "above", "milli"),
        ("timeout_ms = 100", "timeout_ms = 3600010", "command.throttle_frac.timeout_ms", "above", "milliseconds"),
        ("timeout = [", "timeouts = [", "state.timeouts", "no such condition", "timeout"),
    ],
)  # fmt: skip
def test_a_slip_is_found(repo: Path, tmp_path: Path, old: str, new: str, key: str, words: str, hint: str) -> None:
    folder = changed(repo, tmp_path, (old, new))
    found = [problem for problem in check_fields(load_vehicle(folder, check=False)) if problem.key == key]
    assert found and words in found[0].message and hint in found[0].hint, [str(problem) for problem in found]
    with pytest.raises(InputError):
        load_vehicle(folder)


def test_all_slips_are_told_at_once(repo: Path, tmp_path: Path) -> None:
    folder = changed(repo, tmp_path, ("[report.gear]", "[report.gears]"), ("mass_kg = 2080.0", "mass_kg = 0.0"))
    with pytest.raises(InputError) as caught:
        load_vehicle(folder)
    text = str(caught.value)
    assert "3 things" in text and "report.gears" in text and "report.gear:" in text and "nominal.mass_kg" in text


def test_our_vehicles_say_nothing_wrong() -> None:
    for name in ("mkz_bywire", "rav4_2017"):
        assert check_fields(load_vehicle(name, check=False)) == []


def test_of_alternative_command_sets_one_is_enough(repo: Path, tmp_path: Path) -> None:
    """The MKZ maps pedals and steer angle, the RAV4 acceleration and torque; neither lists the other's as absent."""
    for vehicle, gone, missed in (
        ("mkz_bywire", "[command.brake_frac]", "command.brake_frac"),
        ("rav4_2017", "[report.steer_torque_nm]", "report.steer_torque_nm"),
    ):
        folder = changed(repo, tmp_path, (gone, "[extra.X]"), vehicle=vehicle)
        text = (folder / "vehicle.toml").read_text()
        cut = text.index("[extra.X]")
        (folder / "vehicle.toml").write_text(text[:cut] + text[text.index("\n\n", cut) :])
        assert missed in {problem.key for problem in check_fields(load_vehicle(folder, check=False))}


def test_a_vehicle_that_is_only_listened_to() -> None:
    """No command at all: the by-wire fields may be absent, and echoes are then not missed."""
    spec = load_vehicle("rav4_2017", check=False)
    only = replace(spec, command={}, absent=[*spec.absent, "command.accel_mps2", "command.steer_torque_nm"])
    assert check_fields(only) == []
