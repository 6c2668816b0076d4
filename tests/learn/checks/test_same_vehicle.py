"""Logs of one call against each other: one file that is named twice, and a copy of it."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from tests.learn.made_logs import MKZ, car, good, refusals, write_log
from tunefree_hil.learn.checks.same_vehicle import check_same_vehicle
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.drives.read import read_drives


def test_a_file_named_twice_is_refused_and_a_copy_told(tmp_path: Path) -> None:
    """By whatever path; a copy under another name is held out together with what it is a copy of."""
    log = write_log(tmp_path / "a.log", good(MKZ))
    (tmp_path / "link.log").symlink_to(log)
    for again in (log, tmp_path / "link.log"):
        found = refusals(list(check_same_vehicle(read_drives([log, again], car(MKZ).codec))))
        assert found.keys() == {"twice"} and f"{again} is named twice" in found["twice"].words
    copy = Path(shutil.copy(log, tmp_path / "copy.log"))
    (told,) = check_same_vehicle(read_drives([log, copy], car(MKZ).codec))
    assert (told.severity, told.code) == ("warn", "twice") and f"{copy} is the same recording as {log}" in told.words


def turned(name: str, seed: int, from_mps: float, to_mps: float, ratio: float = 15.0) -> Drive:
    """A minute of a car that understeers, slower or faster within one band of speeds."""
    chance, time_s = np.random.default_rng(seed), 0.01 * np.arange(6000)
    speed = from_mps + (to_mps - from_mps) * (0.5 + 0.5 * np.sin(0.3 * time_s))
    steer = 0.55 + 0.1 * np.sin(0.9 * time_s + seed)
    yaw = steer * speed / (ratio * (2.8 + 0.006 * speed**2)) + 0.002 * chance.standard_normal(len(time_s))
    fields = {"report.speed_mps": speed, "report.steer_rad": steer, "report.yaw_rate_radps": yaw}
    always = np.ones(len(time_s), dtype=bool)
    return Drive(name, "", 0.01, fields, dict.fromkeys(fields, always), always)


def test_one_car_that_drives_faster_is_no_other_car() -> None:
    """Within a band of speeds it turns less for the same angle; another steering ratio still shows."""
    slow, fast = turned("slow", 1, 11.1, 12.0), turned("fast", 2, 15.5, 16.6)
    assert list(check_same_vehicle([slow, fast])) == []
    (told,) = check_same_vehicle([slow, turned("other", 2, 15.5, 16.6, ratio=30.0)])
    assert told.severity == "refuse" and told.code == "two_vehicles" and "other turns 0.5" in told.words


def rolled(name: str, seed: int, silent_from: int = 6000) -> Drive:
    """The same with its rear wheels, whose message is heard until then and stands still from there on."""
    drive = turned(name, seed, 5.0, 15.0)
    wheel = drive.fields["report.speed_mps"] / 0.33
    wheel[silent_from:] = wheel[silent_from - 1]
    heard = np.arange(drive.ticks) < silent_from
    wheels = ("report.wheel_rl_radps", "report.wheel_rr_radps")
    fields, fresh = drive.fields | dict.fromkeys(wheels, wheel), {**drive.fresh} | dict.fromkeys(wheels, heard)
    return drive._replace(fields=fields, fresh=fresh)


def test_wheels_that_fall_silent_make_no_other_car() -> None:
    slowest = int(np.argmin(rolled("a", 1).fields["report.speed_mps"]))
    assert list(check_same_vehicle([rolled("a", 1), rolled("b", 2, silent_from=slowest)])) == []
