"""gap on logs that it should not or cannot answer: one message, or an answer that says what to record."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.jobs.command import eventually, finish, start
from tests.learn.made_logs import MKZ, good, rows_of, write_log
from tunefree_hil.bus.formats.rows import Row
from tunefree_hil.cli.entry import run

Rows = list[Row]
CLOCK_S = 30.0


def asked(log: Path, out: Path, *more: str) -> list[str]:
    return ["gap", str(log), "--vehicle", MKZ, "--model", "mkz_nominal", "--out", str(out), "--json", *more]


def foreign() -> Rows:
    return [Row(0.01 * k, "can0", 0x7FF, b"\0", 0) for k in range(500)]


def jumped() -> Rows:
    rows = list(good(MKZ))
    half = len(rows) // 2
    return [*rows[:half], *(row._replace(time_s=round(row.time_s + CLOCK_S, 6)) for row in rows[half:])]


@pytest.mark.parametrize(
    ("made", "said"), [(foreign, "not one frame of vehicle"), (jumped, "cut the log in two")], ids=["foreign", "jump"]
)
def test_logs_that_are_refused(
    made: Callable[[], Rows], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(tmp_path / "a.log", made())
    assert run(asked(log, tmp_path / "out")) == 2
    out, err = capsys.readouterr()
    assert said in err and "Traceback" not in err and "what to do:" in err
    assert json.loads(out)["errors"][0]["code"] in ("foreign_log", "clock_jump")
    assert not (tmp_path / "out").exists()


def test_other_wheels_in_one_call_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def larger(k: int, records: dict[str, Any]) -> dict[str, Any]:
        report = records["report"]
        wheels = {name: 0.85 * getattr(report, name) for name in report._fields if name.startswith("wheel_")}
        return {**records, "report": report._replace(**wheels)}

    first = write_log(tmp_path / "a.log", list(good(MKZ)))
    other = write_log(tmp_path / "b.log", rows_of(MKZ, seed=2, change=larger))
    assert run([*asked(first, tmp_path / "out"), str(other)]) == 2
    assert "wheel" in capsys.readouterr().err


def test_too_short_a_log_is_an_answer_that_says_what_to_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(tmp_path / "a.log", list(good(MKZ)))
    assert run(asked(log, tmp_path / "out")) == 0
    out, err = capsys.readouterr()
    data = json.loads(out)["data"]
    written = json.loads((tmp_path / "out" / "gap.json").read_text())
    assert data["verdict"] == written["verdict"] == "cannot_test" and written["effects"] == []
    assert "these logs cannot tell" in err.splitlines()[-1] and "record" in err.splitlines()[-1]
    assert "NEXT.log" in err.splitlines()[-2]
    (reason,) = written["reasons"]
    assert reason["criterion"] == "too_few_blocks" and reason["value"] < reason["limit"]
    assert "record" in (tmp_path / "out" / "gap.md").read_text()


def test_a_model_of_a_vehicle_that_has_changed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from tunefree_hil.config.load import load_model

    model = tmp_path / "model"
    model.mkdir()
    text = (Path(load_model("mkz_nominal").folder) / "model.toml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("vehicle_hash")]
    at = next(i for i, line in enumerate(lines) if line.startswith("vehicle"))
    lines.insert(at + 1, f'vehicle_hash = "sha256:{"0" * 64}"')
    (model / "model.toml").write_text("\n".join(lines))
    words = ["gap", "no.log", "--vehicle", MKZ, "--model", str(model), "--out", str(tmp_path / "out"), "--json"]
    assert run(words) == 2
    assert json.loads(capsys.readouterr().out)["errors"][0]["code"] == "vehicle_changed"


def test_no_such_log_and_no_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(asked(tmp_path / "none.log", tmp_path / "out")) == 2
    assert "none.log" in capsys.readouterr().err
    assert run(["gap", "--vehicle", MKZ, "--model", "mkz_nominal", "--out", str(tmp_path / "out"), "--json"]) == 2


def searching(log: Path, out: Path) -> subprocess.Popen[str]:
    """A `gap` in the middle of its search."""
    process = start(*asked(log, out, "--plain"))
    assert process.stderr is not None
    said: list[str] = []
    for line in iter(process.stderr.readline, ""):
        said.append(line)
        if "recalibration alone" in line:
            return process
    raise AssertionError("".join(said))


def of_session(leader: int) -> list[int]:
    """Living processes of a session."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it ended while we looked
            state, _, _, session = stat.read_text().rpartition(") ")[2].split()[:4]
            found += [int(stat.parent.name)] if int(session) == leader and state != "Z" else []
    return found


@pytest.mark.slow
def test_cut_off_it_leaves_no_process_and_a_folder_that_the_same_command_goes_on_with(tmp_path: Path) -> None:
    log, out = write_log(tmp_path / "a.log", rows_of(MKZ, 100.0)), tmp_path / "out"
    process = searching(log, out)
    eventually(lambda: len(of_session(process.pid)) > 1, what="a process beside it that shares the search")
    process.kill()
    process.communicate()
    eventually(lambda: not of_session(process.pid), what="the end of what it had started")
    again = searching(log, out)
    os.killpg(again.pid, signal.SIGINT)
    ended = finish(again)
    assert ended.status == 130, ended.words
    assert "interrupted, nothing saved yet" in ended.words and f"--out {out}" in ended.words
    assert {path.name for path in out.iterdir()} == {"gap.lock", "question.json"}
    assert of_session(again.pid) == []


@pytest.mark.slow
def test_a_car_that_stands_is_an_answer_that_says_what_to_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def standing(k: int, records: dict[str, Any]) -> dict[str, Any]:
        still = {"speed_mps": 0.0, "accel_mps2": 0.0, "yaw_rate_radps": 0.0}
        wheels = {name: 0.0 for name in records["report"]._fields if name.startswith("wheel_")}
        report = records["report"]._replace(**still, **wheels, lateral_accel_mps2=0.0)
        return {**records, "report": report, "ins": records["ins"]._replace(**still, x_m=0.0, y_m=0.0, heading_rad=0.0)}

    log = write_log(tmp_path / "a.log", rows_of(MKZ, 100.0, change=standing))
    status = run(asked(log, tmp_path / "out"))
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert "Traceback" not in err and status == 0, err
    assert found["data"]["verdict"] == "cannot_test" and "drive for 45 s" in found["data"]["sentence"]
