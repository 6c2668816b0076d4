"""The measure of real cars: every block judged once, doubles counted once, refusals told, rows of what was run."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.learn.made_bare import accel_drive
from tools.measures import realcars
from tools.measures.realcars import Fold, dart, errors_at, rav4, rows, shown, splits_of
from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.evaluation.velocity_free_run import CONSTANT_SPEED, VelocityErrors, VelocityTrace

HEAD = "elapsed time sensors,current,voltage,acc x (IMU),acc y (IMU),W (IMU),vel encoder,safety_value,throttle,steering"


def a_fold(seed: int, errors: list[float], drive: str = "drive.log") -> Fold:
    speed = np.array([[0.1, 0.2, one] for one in errors])
    time_s = np.arange(0.0, 1.0 + len(errors), 0.1)
    trace = VelocityTrace(drive, time_s, time_s, 0.0 * time_s, {"physics": time_s}, {"physics": 0.0 * time_s})
    many = tuple([drive] * len(errors))
    both = {"physics": speed, CONSTANT_SPEED: 2.0 * speed}
    return Fold(seed, f"split {seed}", 1, VelocityErrors((1.0, 3.0, 10.0), many, both, both, (trace,)))


def test_every_block_of_a_single_drive_is_held_out_once() -> None:
    drive = accel_drive(45.0)
    found = splits_of([drive], 1)
    blocks = [(part.begin, part.end) for _, split in found for part in split.held_out]
    assert sorted(blocks) == [(0, 1500), (1500, 3000), (3000, 4500)]
    for _, split in found:
        (held,) = split.held_out
        assert all(part.end <= held.begin - 200 or part.begin >= held.end + 200 for part in split.training), "guarded"
    others = [drive._replace(name=f"d{i}", log_hash=f"sha256:{i}") for i in range(4)]
    assert len(splits_of(others, 7)) == 1 and splits_of(others, 7)[0][0] == 7


def test_rows_are_of_all_blocks_with_the_spread_between_them() -> None:
    folds = [a_fold(1, [1.0, 1.0, np.nan]), a_fold(2, [3.0]), Fold(3, "split 3", 1, None)]
    errors, blocks = errors_at(folds, "physics", 10.0)
    assert errors.tolist() == [1.0, 1.0, 3.0] and len(set(blocks.tolist())) == 2
    found = rows(folds, 1)
    ten = found["free_run"]["physics"]["10"]
    assert (ten["starts"], ten["blocks"]) == (3, 2) and found["without_a_start"] == ["split 3"]
    assert ten["speed_mps"]["mean"] == pytest.approx(5.0 / 3.0)
    assert ten["speed_mps"]["low"] == 0.0 and ten["speed_mps"]["high"] > 3.0, "two blocks say little"
    assert found["free_run"][CONSTANT_SPEED]["10"]["speed_mps"]["mean"] == pytest.approx(10.0 / 3.0)
    assert errors_at(folds, "hybrid", 10.0)[0].size == 0


def test_the_longest_run_of_each_car_is_shown() -> None:
    (run,) = shown({"car": [a_fold(1, [1.0]), a_fold(2, [1.0, 1.0])], "none": [Fold(1, "", 1, None)]})
    assert run.title == "car" and run.time_s[-1] == pytest.approx(2.9)


def test_doubles_are_taken_once_and_refused_files_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(realcars.SETS, "made", ("dart_10hz", ("a", "b")))
    good = "\n".join([HEAD, *(f"{0.1 * k:.1f},0,0,0,0,0,{0.02 * k:.2f},1,0.3,0.1" for k in range(50))]) + "\n"
    for name, text in (("a/one.csv", good), ("a/two.csv", good.replace("0.3,0.1", "0.4,0.1")), ("b/one.csv", good)):
        path = tmp_path / "dart" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "dart" / "b" / "back.csv").write_text(good + "1.0,0,0,0,0,0,0,1,0.3,0.1\n")
    car = dart("made", tmp_path, tmp_path / "place")
    assert (car.files, car.doubles, len(car.logs)) == (4, 1, 2) and all(log.is_file() for log in car.logs)
    assert list(car.refused) == ["b/back.csv"] and "goes back" in car.refused["b/back.csv"]
    before = [log.stat().st_mtime_ns for log in car.logs]
    assert [log.stat().st_mtime_ns for log in dart("made", tmp_path, tmp_path / "place").logs] == before, "resumed"
    shutil.rmtree(tmp_path / "dart" / "b")
    with pytest.raises(InputError, match="recordings are not there"):
        dart("made", tmp_path, tmp_path / "place")
    with pytest.raises(InputError, match="recordings are not there"):
        rav4(tmp_path, tmp_path / "place")
