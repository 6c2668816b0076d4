"""A reference from a CSV: the same course as the scenario it was sampled from, and mistakes named by row and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.house import ROOT
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_scenario
from tunefree_hil.episode.feasible import curvature_by_time
from tunefree_hil.episode.scenario import build_course
from tunefree_hil.grade.path_projection import course_arrays, project_points
from tunefree_hil.grade.reference import read_reference

DT_S = 0.01
U_TURN = build_course(load_scenario(ROOT / "bench_configs" / "scenarios" / "u_turn.toml"), DT_S)
COLUMNS = ("t_s", "station_m", "x_m", "y_m", "heading_rad", "speed_mps", "curvature_1pm")


def rows_of(stride: int) -> np.ndarray:
    """Every `stride`-th tick of the U-turn, in the order of COLUMNS; shifted and turned into another frame."""
    ticks = np.arange(0, U_TURN.ticks + 1, stride)
    station = np.asarray(U_TURN.station_m)[ticks]
    at = U_TURN.first_station_m + np.arange(len(U_TURN.path_x_m)) * U_TURN.spacing_m
    x, y = np.interp(station, at, U_TURN.path_x_m), np.interp(station, at, U_TURN.path_y_m)
    heading = np.interp(station, at, U_TURN.path_heading_rad)
    curvature = curvature_by_time(U_TURN)[ticks]
    speed = np.asarray(U_TURN.speed_mps)[ticks]
    return np.stack([ticks * DT_S, station, 400.0 - y, 30.0 + x, heading + np.pi / 2.0, speed, curvature], axis=1)


def write(path: Path, names: tuple[str, ...], rows: np.ndarray) -> str:
    columns = [COLUMNS.index(name) for name in names]
    lines = [",".join(names), *(",".join(f"{value:.9g}" for value in row[columns]) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return str(path)


@pytest.mark.parametrize(
    ("names", "tolerance_m"),
    [(COLUMNS, 0.005), (("t_s", "x_m", "y_m", "speed_mps"), 0.03), (("station_m", "x_m", "y_m", "speed_mps"), 0.03)],
)
def test_points_of_a_scenario_give_its_course(tmp_path: Path, names: tuple[str, ...], tolerance_m: float) -> None:
    found = read_reference(write(tmp_path / "points.csv", names, rows_of(10)), DT_S)
    course = found.course
    assert found.in_log_coordinates and found.name == "points"
    assert abs(course.ticks - U_TURN.ticks) <= 10
    rows = min(course.ticks, U_TURN.ticks)
    np.testing.assert_allclose(course.speed_mps[:rows], U_TURN.speed_mps[:rows], atol=0.05)
    np.testing.assert_allclose(course.station_m[:rows], U_TURN.station_m[:rows], atol=0.06)
    nodes = min(len(course.path_x_m), len(U_TURN.path_x_m)) - 2
    np.testing.assert_allclose(course.path_x_m[:nodes], 400.0 - np.asarray(U_TURN.path_y_m[:nodes]), atol=tolerance_m)
    np.testing.assert_allclose(course.path_y_m[:nodes], 30.0 + np.asarray(U_TURN.path_x_m[:nodes]), atol=tolerance_m)
    turned = np.asarray(U_TURN.path_heading_rad[:nodes]) + np.pi / 2.0
    np.testing.assert_allclose(course.path_heading_rad[:nodes], turned, atol=0.05)


def circle(radius_m: float, spacing_m: float, noise_m: float = 0.0) -> str:
    """A CSV's text: once half around at 5 m/s, then standing for a second."""
    count = round(np.pi * radius_m / spacing_m)
    spacing_m = np.pi * radius_m / (count - 1)
    angle = np.concatenate([np.linspace(0.0, np.pi, count), np.full(round(5.0 / spacing_m), np.pi)])
    chance = np.random.default_rng(1)
    x = radius_m * np.sin(angle) + chance.normal(0.0, noise_m, len(angle))
    y = radius_m * (1.0 - np.cos(angle)) + chance.normal(0.0, noise_m, len(angle))
    speed = np.where(np.arange(len(angle)) < count, 5.0, 0.0) + chance.normal(0.0, noise_m, len(angle)) ** 2
    rows = zip(np.arange(len(angle)) * spacing_m / 5.0, x, y, speed, strict=True)
    return "\n".join(["t_s,x_m,y_m,speed_mps", *(",".join(f"{value:.6f}" for value in row) for row in rows)])


@pytest.mark.parametrize(("spacing_m", "noise_m"), [(1.0, 0.0), (0.05, 0.0), (0.05, 0.005)])
def test_the_middle_runs_ahead_of_the_rear_axle(tmp_path: Path, spacing_m: float, noise_m: float) -> None:
    """Without slip it runs on a circle of sqrt(R^2 + l^2); where the rear axle is planned, its foot is."""
    path, ahead_m, radius_m = tmp_path / "circle.csv", 1.4224, 10.0
    path.write_text(circle(radius_m, spacing_m, noise_m))
    course = read_reference(str(path), DT_S, ahead_m).course
    nodes = course.first_station_m + np.arange(len(course.path_x_m)) * course.spacing_m
    inner = (nodes > ahead_m + 2.0) & (nodes < np.pi * radius_m - 2.0)
    outer_m = np.hypot(radius_m, ahead_m)
    distance = np.hypot(np.asarray(course.path_x_m)[inner], np.asarray(course.path_y_m)[inner] - radius_m)
    np.testing.assert_allclose(distance, outer_m, atol=0.02 + 3.0 * noise_m)
    curvature = np.asarray(course.path_curvature_1pm)[inner]
    np.testing.assert_allclose(curvature, 1.0 / outer_m, atol=0.01 + 10.0 * noise_m)
    np.testing.assert_allclose(course.station_m[-1], np.pi * outer_m, rtol=0.005 + noise_m)
    ticks = np.arange(100, 500, 10)
    angle = 5.0 * ticks * DT_S / radius_m
    rear = radius_m * np.sin(angle), radius_m * (1.0 - np.cos(angle))
    feet = project_points(course_arrays(course), *rear)
    np.testing.assert_allclose(np.asarray(course.station_m)[ticks], feet.station_m, atol=0.1)
    np.testing.assert_allclose(feet.lateral_m, outer_m - radius_m, atol=0.02 + 3.0 * noise_m)


def test_noise_of_a_recorded_drive_is_no_acceleration_and_no_way(tmp_path: Path) -> None:
    path = tmp_path / "circle.csv"
    path.write_text(circle(10.0, 0.05, 0.01))
    course = read_reference(str(path), DT_S).course
    assert np.abs(np.asarray(course.accel_mps2)[:550]).max() < 0.1
    assert course.station_m[-1] == pytest.approx(10.0 * np.pi, rel=0.01), "0.05 m apart, noise would add 4 %"
    standing = np.asarray(course.station_m)[-80:]
    assert np.ptp(standing) < 0.05, "it stands"


def test_a_scenario_by_name() -> None:
    found = read_reference("u_turn", DT_S)
    assert (
        not found.in_log_coordinates
        and found.name == "u_turn"
        and found.course.ticks == U_TURN.ticks
        and len(found.hash) == 64
    )


BROKEN = [
    ("x_m,speed_mps\n0,1\n", "y_m", "has no column 'y_m'"),
    ("x_m,y_m,speed_mps\n0,0,1\n1,0,1\n", "", "has 2 points"),
    ("x_m,y_m,speed_mps\n0,0,1\n1,zero,1\n2,0,1\n", "y_m", "row 3: 'zero'"),
    ("x_m,y_m,speed_mps\n0,0,1\n1,0\n2,0,1\n", "speed_mps", "row 3: ''"),
    ("x_m,y_m,speed_mps\n0,0,1\n1,0,-1\n2,0,1\n", "speed_mps", "negative"),
    ("x_m,y_m,speed_mps\n0,0,1\n1,0,0\n2,0,0\n", "t_s", "its duration is"),
    ("t_s,x_m,y_m,speed_mps\n0,0,0,1\n2,1,0,1\n1,2,0,1\n", "t_s", "row 4 does not"),
    ("t_s,x_m,y_m,speed_mps\n0,0,0,1\n1,0,0,1\n2,0,0,1\n", "", "a path needs 3 points"),
    ("station_m,x_m,y_m,speed_mps\n0,0,0,1\n1,1,0,1\n1,2,0,1\n2,3,0,1\n", "station_m", "must ascend"),
    ("", "x_m", "has no column"),
]


@pytest.mark.parametrize(("text", "key", "part"), BROKEN)
def test_mistakes_are_named(tmp_path: Path, text: str, key: str, part: str) -> None:
    path = tmp_path / "p.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_reference(str(path), DT_S)
    assert part in caught.value.message and caught.value.key == key and caught.value.file == str(path)


PLAIN = "x_m,y_m,speed_mps\n0,0,5\n1,0,5\n2,0,5\n"


def test_a_byte_order_mark_is_no_part_of_the_first_name(tmp_path: Path) -> None:
    """As Excel's "CSV UTF-8" has it."""
    path = tmp_path / "p.csv"
    courses = []
    for encoding in ("utf-8", "utf-8-sig"):
        path.write_text(PLAIN, encoding=encoding)
        courses.append(read_reference(str(path), DT_S).course)
    assert courses[0] == courses[1]


@pytest.mark.parametrize(
    "content", ["# Stra\xdfe\n".encode("latin-1") + PLAIN.encode(), PLAIN.encode("utf-16"), b"x" * 200_000]
)
def test_what_is_no_text_in_utf_8_is_one_message(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not a CSV in UTF-8") as caught:
        read_reference(str(path), DT_S)
    assert caught.value.file == str(path) and "UTF-8" in caught.value.hint


ASTRAY = {  # by the line on which it stands, two remarks and an empty line above it
    "x_m,y_m,speed_mps\n# two\n0,0,1\n\n1,zero,1\n2,0,1\n": "row 6: 'zero'",
    "t_s,x_m,y_m,speed_mps\n0,0,0,1\n# two\n2,1,0,1\n\n1,2,0,1\n": "row 7 does not",
    "x_m,y_m,speed_mps\n0,0,1\n# two\n1,0,0\n\n2,0,0\n3,0,1\n": "row 7: the plan stands still",
    # Rows nearer together than half a metre are one place, which begins with the first of them
    "station_m,x_m,y_m,speed_mps\n0,0,0,1\n0,.1,0,1\n1,1,0,1\n1,1.1,0,1\n# two\n1,2,0,1\n2,3,0,1\n": "row 8 does not",
}


@pytest.mark.parametrize(("text", "part"), ASTRAY.items())
def test_the_row_that_is_named_is_the_files_line(tmp_path: Path, text: str, part: str) -> None:
    path = tmp_path / "p.csv"
    path.write_text("# one\n" + text)
    with pytest.raises(InputError) as caught:
        read_reference(str(path), DT_S)
    assert part in caught.value.message


def test_a_file_that_is_not_there() -> None:
    with pytest.raises(InputError, match=r"no such file"):
        read_reference("nowhere.csv", DT_S)
