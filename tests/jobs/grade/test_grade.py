"""`grade`: our own log gives the metrics that its drive was scored with; a real car's gives what it can."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.bench.tiny import write_bench
from tests.jobs.made_runs import made_drive
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_weights
from tunefree_hil.episode.recording import load_recording
from tunefree_hil.grade.oscillation.report import (
    DrivePlace,
    OscillationFinding,
    OscillationReport,
    OscillationSignal,
)
from tunefree_hil.grade.score import SCORE_METRICS
from tunefree_hil.grade.table import PUBLISHED
from tunefree_hil.jobs.grade.grade import grade_log
from tunefree_hil.jobs.log.convert import convert
from tunefree_hil.jobs.log.options import LogConvertOptions
from tunefree_hil.jobs.options.records import GradeOptions


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An episode of two seconds, driven."""
    folder = tmp_path_factory.mktemp("driven")
    return made_drive(write_bench(folder), folder / "runs", "a", {}) / "episodes" / "0"


@pytest.fixture(autouse=True)
def _no_figures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures cost more than all the rest; the tests that want them say "draws" in their names."""
    if "draws" not in request.node.name:
        for name in ("_figures", "_oscillation_figure"):
            monkeypatch.setattr(f"tunefree_hil.jobs.grade.grade.{name}", lambda *_: [])


def graded(log: Path, path: str, out: Path, **more: Any) -> tuple[list[Event], dict[str, Any]]:
    options = {"vehicle": None, "align": "auto", "start_s": None, "weights": "default", **more}
    events = list(grade_log(log, GradeOptions(path=path, out=out, **options)))
    return events, events[-1].data


def tiny(episode: Path) -> str:
    return str(episode.parents[3] / "scenarios" / "tiny.toml")


@pytest.mark.slow
def test_our_own_log_is_graded_as_it_was_driven_and_draws(episode: Path, tmp_path: Path) -> None:
    _, data = graded(episode / "vehicle.log", tiny(episode), tmp_path)
    stored = json.loads((episode / "episode.json").read_text())
    assert {name: data["metrics"][name]["value"] for name in SCORE_METRICS} == stored["metrics"]
    assert data["score"] == stored["score"] and data["outcome"] == "finished"
    assert data["metrics"]["total_time_peak"]["value"] == pytest.approx(0.1)
    assert data["metrics"]["control_error_code_count"]["value"] == 0.0
    run = Path(data["run"])
    assert all((run / "figures" / name).is_file() for name in ("drive.png", "profile.png"))
    first, again = load_recording(episode / "columns.npz"), load_recording(run / "episodes" / "0" / "columns.npz")
    assert first.columns.keys() == again.columns.keys()
    for name, column in first.columns.items():
        np.testing.assert_array_equal(again.columns[name], column)


def test_a_log_alone_on_another_clock_and_without_a_bench(episode: Path, tmp_path: Path) -> None:
    """As a real car's: stamps of the day, nothing beside the log. Times of arrival move it by a tick at most."""
    lines = (episode / "vehicle.log").read_text().splitlines()
    stamps = [float(line[1 : line.index(")")]) for line in lines]
    log = tmp_path / "car.log"
    shifted = [
        f"({t + 1700000000.0031:.6f}){line[line.index(')') + 1 :]}" for t, line in zip(stamps, lines, strict=True)
    ]
    log.write_text("\n".join(shifted) + "\n")
    events, data = graded(log, tiny(episode), tmp_path / "out", vehicle="mkz_bywire")
    stored = json.loads((episode / "episode.json").read_text())
    assert any("real time: second 0 is the log's first frame" in event.message for event in events)
    assert data["metrics"]["control_error_code_count"]["value"] is None
    assert "compute times" in data["metrics"]["total_time_usage"]["why"]
    for name in ("lateral_err_peak", "lateral_err_std", "heading_err_std", "speed_err_std"):
        assert data["metrics"][name]["value"] == pytest.approx(stored["metrics"][name], rel=0.1), name


@pytest.mark.parametrize("name", ["blf", "asc"])
def test_other_formats_give_the_same(name: str, episode: Path, tmp_path: Path) -> None:
    log = tmp_path / f"drive.{name}"
    list(convert(LogConvertOptions(episode / "vehicle.log", log)))
    _, data = graded(log, tiny(episode), tmp_path / "out", vehicle="mkz_bywire")
    stored = json.loads((episode / "episode.json").read_text())
    assert {metric: data["metrics"][metric]["value"] for metric in SCORE_METRICS} == stored["metrics"]


def test_the_part_of_a_log_that_is_there(episode: Path, tmp_path: Path) -> None:
    log = tmp_path / "half.log"
    lines = (episode / "vehicle.log").read_text().splitlines(keepends=True)
    log.write_text("".join(lines[: len(lines) // 2]))
    _, data = graded(log, tiny(episode), tmp_path, vehicle="mkz_bywire")
    assert data["score"] is None and "no score: the log contains 1.0 s of the planned 2.0 s" in data["sentence"]
    assert data["metrics"]["lateral_err_peak"]["value"] is not None


def test_what_stands_in_and_what_was_driven_by_hand_is_said(episode: Path, tmp_path: Path) -> None:
    """Without the gyro's report the INS's yaw rate counts; for 0.8 s the brake's report says that it is not enabled."""
    lines = []
    for line in (episode / "vehicle.log").read_text().splitlines():
        time_s, (head, data) = float(line[1 : line.index(")")]), line.split("#")
        if head.endswith(" 06C"):
            continue
        if head.endswith(" 061") and 1.0 <= time_s < 1.79:
            data = f"{data[:14]}{int(data[14:], 16) & 0xFE:02X}"
        lines.append(f"{head}#{data}")
    log = tmp_path / "by_hand.log"
    log.write_text("\n".join(lines) + "\n")
    _, data = graded(log, tiny(episode), tmp_path, vehicle="mkz_bywire")
    said = " ".join(data["notes"])
    assert "yaw_rate_radps: from ins.yaw_rate_radps" in said
    assert "by-wire control was not enabled for 0.8 s" in said
    _, late = graded(log, tiny(episode), tmp_path, vehicle="mkz_bywire", start_s=1.8)
    assert "not enabled" not in " ".join(late["notes"]), "it was before the start"
    _, whole = graded(episode / "vehicle.log", tiny(episode), tmp_path)
    assert not any("not enabled" in note or "from ins" in note for note in whole["notes"])


def test_a_start_that_is_not_in_the_log(episode: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the start at 60"):
        graded(episode / "vehicle.log", tiny(episode), tmp_path, start_s=60.0)


@pytest.mark.parametrize("way", ["ahead", "back"])
def test_a_clock_that_jumps_is_refused_before_its_ticks_are_counted(way: str, episode: Path, tmp_path: Path) -> None:
    lines = (episode / "vehicle.log").read_text().splitlines()
    half = len(lines) // 2
    later = [f"({float(line[1:].split(')')[0]) + 1.7e9:.6f}){line.partition(')')[2]}" for line in lines]
    halves = [lines[:half], later[half:]] if way == "ahead" else [later[:half], lines[half:]]
    log = tmp_path / "stepped.log"
    log.write_text("\n".join(line for part in halves for line in part) + "\n")
    with pytest.raises(InputError, match=f"the clock jumps {way} by 1.7e") as caught:
        graded(log, tiny(episode), tmp_path, vehicle="mkz_bywire")
    assert caught.value.code == "clock_jump" and caught.value.file == str(log) and "cut the log" in caught.value.hint


@pytest.mark.parametrize("start_s", [math.nan, math.inf, -math.inf, -1.0, 1e308])
def test_a_start_that_is_no_time_is_refused_before_anything_is_read(start_s: float, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--start-s") as caught:
        graded(tmp_path / "no.log", "u_turn", tmp_path, start_s=start_s)
    assert caught.value.key == "--start-s" and caught.value.hint


def test_a_path_of_points(episode: Path, tmp_path: Path) -> None:
    """The driven path itself as the reference: no lateral error but what 0.1 s between points leaves."""
    driven = load_recording(episode / "columns.npz")
    rows = slice(2, None, 10)
    names = ("t_s", "x_m", "y_m", "heading_rad", "speed_mps")
    table = np.stack([driven.columns[name][rows] for name in names], axis=1)
    path = tmp_path / "path.csv"
    path.write_text("\n".join([",".join(names), *(",".join(map(str, row)) for row in table.tolist())]) + "\n")
    _, data = graded(episode / "vehicle.log", str(path), tmp_path)
    peak = data["metrics"]["lateral_err_peak"]["value"]
    assert data["scenario"] == "path" and peak < 0.2


@pytest.mark.slow
def test_a_minute_of_a_real_car(shared_data: Path, tmp_path: Path) -> None:
    """No INS: longitudinal metrics only, everything else null with its reason."""
    log = shared_data / "comma2k19_rav4" / "drive.candump.log"
    if not log.is_file():
        pytest.skip(f"{log.name} of comma2k19_rav4 is not in the shared data")
    events, data = graded(log, "rav4_drive", tmp_path, vehicle="rav4_2017")
    had = {name for name in PUBLISHED if data["metrics"][name]["value"] is not None}
    assert had == {f"{what}_{how}" for what in ("station_err", "speed_err") for how in ("std", "std_harsh", "peak")}
    assert all((metric["value"] is None) == bool(metric["why"]) for metric in data["metrics"].values())
    assert data["metrics"]["station_rms_after_start"]["value"] > 0 and data["metrics"]["lateral_rms_after_start"]["why"]
    assert "no lateral_error_m" in data["metrics"]["lateral_err_peak"]["why"]
    assert data["metrics"]["speed_err_std"]["value"] < 0.01, "the scenario was made of this log"
    said = " ".join(event.message for event in events)
    assert "the start was found by the speed, 9.0" in said and "no lateral errors" in said
    assert data["outcome"] == "finished" and math.isfinite(data["score"])
    weighted = load_weights("default").metrics
    assert set(data["dropped"]) == {name for name in weighted if data["metrics"][name]["value"] is None}
    assert 0 < len(data["dropped"]) < len(weighted)


def swinging(range_: float) -> OscillationReport:
    one = OscillationFinding(
        OscillationSignal.STEER_MEASURED, range_, 0.05, "rad", 1.7, 3.2, 14.0, DrivePlace.STRAIGHT, 18.0
    )
    return OscillationReport((one,))


def test_an_oscillation_is_said_and_kept(episode: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "steering wheel swings 58 deg at 1.7 Hz from 3.2 to 14.0 s, straight, at 18 m/s"
    monkeypatch.setattr(
        "tunefree_hil.jobs.grade.grade.find_drive_oscillations", lambda *_: swinging(math.radians(58.0))
    )
    events, data = graded(episode / "vehicle.log", tiny(episode), tmp_path)
    assert data["sentence"].endswith(f"; OSCILLATES: {text}")
    assert f"  {text}: 20 of the limit" in [event.message for event in events]
    [plain] = json.loads((Path(data["run"]) / "grade.json").read_text())["oscillation"]
    assert plain["signal"] == "steer_measured" and plain["ratio"] == pytest.approx(math.radians(58.0) / 0.05)
    monkeypatch.setattr("tunefree_hil.jobs.grade.grade.find_drive_oscillations", lambda *_: swinging(0.04))
    _, calm = graded(episode / "vehicle.log", tiny(episode), tmp_path)
    assert "OSCILLATES" not in calm["sentence"] and calm["oscillation"]
