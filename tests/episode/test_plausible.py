"""Swapped units are caught by the columns themselves, and the unit that was meant is named; a right drive is not."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.episode.drives import in_units, motion, write_csv, write_map
from tunefree_hil.config.load import load_import
from tunefree_hil.episode.csv_drive import read_csv_drive
from tunefree_hil.episode.plausible import Finding, check_units


def findings(folder: Path, rows: list[dict], said: dict[str, str] | None = None, **more: object) -> list[Finding]:
    spec = load_import(write_map(folder / "m.toml", said, **more))  # type: ignore[arg-type]
    return check_units(read_csv_drive(write_csv(folder / "d.csv", rows), spec))


def test_a_right_drive_holds(tmp_path: Path) -> None:
    found = findings(tmp_path, motion())
    assert [one.check for one in found] == [
        "speed_and_path",
        "yaw_rate_and_heading",
        "accel_and_speed",
        "heading_and_path",
    ]
    assert all(one.holds for one in found)
    assert all(one.factor == pytest.approx(1.0, abs=0.03) for one in found)


@pytest.mark.parametrize(
    ("column", "unit"),
    [("v", "km/h"), ("v", "mph"), ("r", "deg/s"), ("psi", "deg"), ("x", "ft"), ("a", "g"), ("thr", "%")],
)
def test_right_units_of_every_kind_hold(tmp_path: Path, column: str, unit: str) -> None:
    units = {column: unit} | ({"y": unit} if column == "x" else {})
    assert all(one.holds for one in findings(tmp_path, in_units(motion(), units), units))


@pytest.mark.parametrize(
    ("column", "said", "true", "check"),
    [
        ("v", "km/h", "m/s", "speed_and_path"),
        ("v", "m/s", "km/h", "speed_and_path"),
        ("v", "m/s", "mph", "speed_and_path"),
        ("r", "rad/s", "deg/s", "yaw_rate_and_heading"),
        ("r", "deg/s", "rad/s", "yaw_rate_and_heading"),
        ("psi", "rad", "deg", "yaw_rate_and_heading"),
        ("psi", "deg", "rad", "yaw_rate_and_heading"),
        ("a", "m/s2", "g", "accel_and_speed"),
        ("a", "g", "m/s2", "accel_and_speed"),
    ],
)
def test_a_swapped_unit_is_named(tmp_path: Path, column: str, said: str, true: str, check: str) -> None:
    found = findings(tmp_path, in_units(motion(), {column: true}), {column: said})
    wrong = {one.check: one.words for one in found if one.holds is False}
    assert check in wrong
    assert f"'{column}'" in wrong[check] and f"given in {said}" in wrong[check]
    assert f"they agree with '{column}' in {true}" in wrong[check]


def test_without_positions_the_acceleration_still_tells(tmp_path: Path) -> None:
    found = findings(tmp_path, in_units(motion(), {"v": "km/h"}), None, columns=["v", "a"])
    (wrong,) = [one for one in found if one.holds is False]
    assert wrong.check == "accel_and_speed" and "'v' in km/h" in wrong.words


def test_per_cent_said_to_be_a_fraction(tmp_path: Path) -> None:
    found = findings(tmp_path, in_units(motion(), {"thr": "%"}))
    (wrong,) = [one for one in found if one.holds is False]
    assert wrong.check == "range" and "it would fit in %" in wrong.words


def test_a_sign_that_is_turned_round(tmp_path: Path) -> None:
    rows = [row | {"r": -row["r"]} for row in motion()]
    (wrong,) = [one for one in findings(tmp_path, rows) if one.holds is False]
    assert wrong.check == "yaw_rate_and_heading" and "sign is turned round" in wrong.words


def test_a_car_that_stands_is_not_judged(tmp_path: Path) -> None:
    rows = [row | {"v": 0.0, "a": 0.0, "r": 0.0, "x": 1.0, "y": 2.0, "psi": 0.1} for row in motion()]
    assert all(one.holds is None and "not judged" in one.words for one in findings(tmp_path, rows))


def test_noise_of_a_car_that_stands_is_no_way(tmp_path: Path) -> None:
    """Positions that shake by 5 cm make 3 m of way within 20 s, and a way is never negative."""
    chance = random.Random(1)
    rows = [
        row | {"v": chance.gauss(0.0, 0.01), "x": chance.gauss(0.0, 0.05), "y": chance.gauss(0.0, 0.05)}
        for row in motion()
    ]
    (found,) = findings(tmp_path, rows, None, columns=["v", "x", "y"])
    assert found.holds is None and "hardly move" in found.words


def test_a_constant_bias_of_the_accelerometer_is_no_fault(tmp_path: Path) -> None:
    rows = [row | {"a": row["a"] - 0.5} for row in motion()]
    assert all(one.holds for one in findings(tmp_path, rows))


def test_windows_do_not_reach_over_gaps(tmp_path: Path) -> None:
    """Ten seconds without a row, in which the car moved on: no factor may come of it."""
    rows = [row for row in motion() if not 4.0 < row["t"] < 14.0]
    found = findings(tmp_path, rows)
    assert all(one.holds for one in found)
    assert all(one.factor == pytest.approx(1.0, abs=0.03) for one in found)


RADIUS_M = 0.35


def wheels(folder: Path, factor: float) -> list[Finding]:
    """A drive whose wheels roll at `factor` times the reported speed, by the wheel radius."""
    head = 'schema = "tunefree.import/1"\nname = "w"\nsource = "test"\n[clock]\ncolumn = "t"\n'
    named = {f"w{at}": f"report.wheel_{at}_radps" for at in ("fl", "fr", "rl", "rr")} | {"v": "report.speed_mps"}
    tables = [
        f'[[columns]]\ncolumn = "{column}"\nfield = "{field}"\nunit = "{"m/s" if column == "v" else "rad/s"}"\n'
        for column, field in named.items()
    ]
    (folder / "m.toml").write_text(head + "".join(tables))
    rows = [
        {"t": row["t"], "v": row["v"]} | {name: factor * row["v"] / RADIUS_M for name in named if name != "v"}
        for row in motion()
    ]
    drive = read_csv_drive(write_csv(folder / "d.csv", rows), load_import(folder / "m.toml"))
    return check_units(drive, wheel_radius_m=RADIUS_M)


def test_wheels_and_speed(tmp_path: Path) -> None:
    (found,) = wheels(tmp_path, 1.02)
    assert found.check == "wheels_and_speed" and found.holds and found.factor == pytest.approx(1.0 / 1.02)


def test_wheels_in_revolutions_are_named(tmp_path: Path) -> None:
    """All four are given in rad/s and are in rpm: one of them alone would not do."""
    (found,) = [one for one in wheels(tmp_path, 60.0 / (2.0 * 3.141592653589793)) if one.check == "wheels_and_speed"]
    assert found.holds is False and "'wfl' and 'wfr' and 'wrl' and 'wrr' in rpm" in found.words
