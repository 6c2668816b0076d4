"""What goes out of the exam is a valid CAN log and vehicle folder, and holds no trace of the answer."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import cantools
import numpy as np
import pytest

from tests.house import ROOT
from tests.tools.gap_exam.drives_for_tests import DOMAIN, clean, vehicle
from tools.gap_exam import bus, cases
from tools.gap_exam.cases import draw_effect
from tools.gap_exam.catalogue import EFFECTS, OUTSIDE
from tools.gap_exam.driver import CONTROLLER, PERSON
from tools.gap_exam.layout import MESSAGES, dbc, fields

LINE = re.compile(r"\((\d+\.\d{6})\) can0 ([0-9A-F]{3})#([0-9A-F]{16})")


def test_the_dbc_is_one_and_whole() -> None:
    network = cantools.database.load_string(dbc(), "dbc")
    assert {one.name for one in network.messages} == {one.name for one in MESSAGES}
    for message in MESSAGES:
        covered: set[int] = set()
        for one in message.signals:
            bits = set(range(one.start, one.start + one.bits))
            assert not covered & bits and max(bits) < 64, (message.name, one.name)
            covered |= bits
    assert "CM_" not in dbc(), "no comments"


def test_folders_of_two_cars_differ_in_numbers_only() -> None:
    texts = [re.sub(r"-?\d+\.?\d*(e-?\d+)?", "#", bus.toml(vehicle(number))) for number in (0, 3)]
    assert texts[0] == texts[1]
    words = " ".join([*EFFECTS, *OUTSIDE, "mismatch", "seed", "hidden", "effect"]).split()
    text = (bus.toml(vehicle(0)) + dbc()).replace("_stiffness_n_per_rad", "")
    assert not [word for word in words if word in text]


@pytest.mark.slow
def test_a_log_says_what_was_driven() -> None:
    """Decoded by the DBC: values within half a step; ids, periods and order as declared; stamps in order."""
    made = clean()
    lines = [LINE.fullmatch(line) for line in cases.log_of(made, 5).splitlines()]
    assert all(lines)
    stamps = np.array([float(line[1]) for line in lines if line])
    assert (np.diff(stamps) >= 0.0).all()
    network = cantools.database.load_string(dbc(), "dbc")
    ticks = len(made.drive.commands)
    for message in MESSAGES:
        mine = [line for line in lines if line and int(line[2], 16) == message.can_id]
        assert len(mine) == ticks * bus.TICK_MS // message.period_ms
        times = np.array([float(line[1]) for line in mine])
        assert np.abs(np.diff(times) - 1e-3 * message.period_ms).max() < 1e-4
    steer = network.get_message_by_name("STEER_STATE")
    said = [steer.decode(bytes.fromhex(line[3])) for line in lines if line and line[2] == "212"]
    angle = np.radians([one["ANGLE"] for one in said])
    assert np.abs(angle - made.drive.reports[:, 5]).max() <= np.radians(0.026)
    command = network.get_message_by_name("BRAKE_DEMAND")
    duty = [command.decode(bytes.fromhex(line[3]))["DUTY"] for line in lines if line and line[2] == "111"]
    rest = made.vehicle.car.rest_frac
    assert np.allclose(duty, made.drive.commands[:, 1] + rest, atol=1e-9), "commands go out as they were obeyed"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["steer_lag", "payload", "report_latency", "body_roll", "frame_loss"])
def test_two_truths_differ_in_payloads_only(name: str) -> None:
    """Same seed, another truth: same stamps, ids, lengths and number of frames, and so the same size of file."""
    effects = {name: draw_effect(name, DOMAIN.rng(name), 0.8)}
    logs = [cases.log_of(cases.make(vehicle(), what, "excited", PERSON, 11, 20.0), 11) for what in ({}, effects)]
    assert logs[0] != logs[1]
    bare = [re.sub(r"#[0-9A-F]{16}", "#", log) for log in logs]
    assert bare[0] == bare[1]


@pytest.mark.slow
def test_the_same_seed_is_the_same_log_and_another_is_another() -> None:
    logs = [cases.log_of(cases.make(vehicle(), {}, "ordinary", PERSON, seed, 15.0), seed) for seed in (4, 4, 5)]
    assert logs[0] == logs[1] != logs[2]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ordinary", "excited"])
@pytest.mark.parametrize("who", [PERSON, CONTROLLER])
def test_drives_stay_within_the_limits(kind: str, who: int) -> None:
    for number in range(4):
        car = vehicle(number)
        made = cases.make(car, {}, kind, who, DOMAIN.seed("limits", number), 120.0)
        commands, body, limits = made.drive.commands, made.drive.body, car.limits
        assert commands[:, 0].max() <= limits.throttle_frac - car.car.rest_frac + 1e-9
        assert commands[:, 1].max() <= limits.brake_frac - car.car.rest_frac + 1e-9
        assert np.abs(commands[:, 2]).max() <= limits.steer_rad
        assert np.abs(np.diff(commands[:, 2])).max() / 0.01 <= limits.steer_rate_radps + 0.2
        assert body[:, 0].min() >= 0.0 and body[:, 0].max() <= limits.speed_mps
        assert np.percentile(np.abs(body[:, 14]), 99.5) <= limits.lateral_mps2
        assert body[:, 0].max() > 8.0, "it gets somewhere"
        assert (commands[:, 0] * commands[:, 1]).max() == 0.0, "one pedal at a time"


@pytest.mark.slow
def test_lost_command_frames_are_lost_on_the_way_to_the_unit() -> None:
    effects = {"frame_loss": {"burst_s": 0.3, "bursts_per_s": 0.5}}
    made = cases.make(vehicle(), effects, "excited", CONTROLLER, 3, 60.0)
    assert 0.02 < made.lost.mean() < 0.5
    echo = made.drive.reports[:, 4]
    held = np.flatnonzero(made.lost[:-1] & made.lost[1:])
    assert np.abs(np.diff(echo)[held]).max() < 1e-9, "the unit holds what it heard last"
    late = np.abs(echo[1:] - made.drive.commands[:-1, 2])
    assert late[~made.lost[:-1]].max() < 1e-9 < late.max()


@pytest.mark.slow
def test_pieces_are_as_long_as_asked_for() -> None:
    for seconds in (10.0, 60.0):
        assert len(cases.make(vehicle(), {}, "excited", CONTROLLER, 1, seconds).drive.commands) == 100 * seconds


@pytest.mark.slow
def test_doctor_accepts_the_folder(tmp_path: Path) -> None:
    bus.write_folder(tmp_path / "car", vehicle())
    words = [sys.executable, "-m", "tunefree_hil", "doctor", "--vehicle", str(tmp_path / "car"), "--json"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0 and '"status": "ok"' in done.stdout, done.stderr + done.stdout


def test_every_field_of_the_folder_has_its_signals() -> None:
    found = fields()
    assert len(found["report.wheel_speed_radps"][1]) == 4
    assert {"command.steer_rad", "report.steer_command_rad", "ins.x_m", "report.gear"} <= found.keys()
