"""The logs of one call are compared with each other."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from tests.learn.made_logs import MKZ, car, good, refusals, write_log
from tunefree_hil.learn.checks.same_vehicle import check_same_vehicle
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.drives.read import read_drives


def test_a_file_named_twice_is_refused_and_a_copy_told(tmp_path: Path) -> None:
    """Also through a link; a copy under another name is only a warning, because a split keeps copies together."""
    log = write_log(tmp_path / "a.log", good(MKZ))
    (tmp_path / "link.log").symlink_to(log)
    for again in (log, tmp_path / "link.log"):
        problems = refusals(list(check_same_vehicle(read_drives([log, again], car(MKZ).codec))))
        assert problems.keys() == {"twice"} and f"{again} is named twice" in problems["twice"].message
    copy = Path(shutil.copy(log, tmp_path / "copy.log"))
    (warning,) = check_same_vehicle(read_drives([log, copy], car(MKZ).codec))
    assert (warning.severity, warning.code) == (
        "warn",
        "twice",
    ) and f"{copy} is the same recording as {log}" in warning.message


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
    (refusal,) = check_same_vehicle([slow, turned("other", 2, 15.5, 16.6, ratio=30.0)])
    assert refusal.severity == "refuse" and refusal.code == "two_vehicles" and "other turns 0.5" in refusal.message


def rolled(name: str, seed: int, silent_from: int = 6000) -> Drive:
    """The same car with its rear wheels, whose message stops at a row and keeps its last value."""
    drive = turned(name, seed, 5.0, 15.0)
    wheel = drive.fields["report.speed_mps"] / 0.33
    wheel[silent_from:] = wheel[silent_from - 1]
    is_received = np.arange(drive.n_rows) < silent_from
    wheels = ("report.wheel_rl_radps", "report.wheel_rr_radps")
    fields, fresh = (
        {**drive.fields} | dict.fromkeys(wheels, wheel),
        {**drive.fresh} | dict.fromkeys(wheels, is_received),
    )
    return drive._replace(fields=fields, fresh=fresh)


def test_wheels_that_fall_silent_make_no_other_car() -> None:
    slowest = int(np.argmin(rolled("a", 1).fields["report.speed_mps"]))
    assert list(check_same_vehicle([rolled("a", 1), rolled("b", 2, silent_from=slowest)])) == []
