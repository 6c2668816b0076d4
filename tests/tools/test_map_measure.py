"""The measure `map`: what the learned map is held against, and what it says without logs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import other_vehicle
from tests.house import ROOT
from tests.learn.made_pedals import REST, some_drive, vehicle
from tools.measures import map as measure
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.bench.controller import calibration_of
from tunefree_hil.learn.open_loop_map.build import gather_samples, select_points
from tunefree_hil.learn.open_loop_map.cells import CellPoints, make_cell_edges, split_holdout
from tunefree_hil.learn.open_loop_map.samples import PEDALS, THROTTLE


def test_without_logs_it_says_who_makes_them(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no logs") as caught:
        measure.logs_in("", str(tmp_path), "mkz_bywire")
    assert "tools/measure collect" in caught.value.hint
    (tmp_path / "a" / "b").mkdir(parents=True)
    for name in ("a/drive-001.log", "a/b/drive-002.log", "a/bench.log"):
        (tmp_path / name).write_text("")
    found = measure.logs_in(str(tmp_path / "a"), "", "mkz_bywire")
    assert [path.name for path in found] == ["drive-002.log", "drive-001.log"]


def test_the_newest_collection_of_the_vehicle_is_taken(tmp_path: Path) -> None:
    for age, (name, bench) in enumerate(
        (("old", "mkz_steer"), ("new", "mkz_steer"), ("other", other_vehicle.BENCH.stem))
    ):
        logs = tmp_path / "collect" / name / "logs"
        logs.mkdir(parents=True)
        (logs.parent / "bench.toml").write_text((ROOT / "bench_configs" / f"{bench}.toml").read_text())
        (logs / "drive-001.log").write_text("")
        os.utime(logs, (age, age))
    (path,) = measure.logs_in("", str(tmp_path), "mkz_bywire")
    assert path.parts[-3:] == ("new", "logs", "drive-001.log")


def test_binned_averages_are_linear_between_cells_and_the_nearest_outside() -> None:
    edges = make_cell_edges(vehicle(), THROTTLE)
    speed, command = (one.ravel() for one in np.meshgrid([4.5, 5.5, 6.5], [0.2, 0.3, 0.4]))
    points = CellPoints(speed, command, speed + command, np.arange(9), np.ones(9))
    law = measure.binned(points, edges)
    assert law(np.array([4.5, 5.0, 6.5]), np.array([0.3, 0.3, 0.4])) == pytest.approx([4.8, 5.3, 6.9], abs=0.02)
    assert law(np.array([6.5]), np.array([REST])) == pytest.approx([6.7], abs=0.02)


def test_the_same_bench_with_another_map_drives_by_it(tmp_path: Path) -> None:
    bench = load(ROOT / "bench_configs" / "mkz_complete.toml")
    other = measure.with_map(bench, tmp_path / "own.npz")
    np.savez(tmp_path / "own.npz", speed_mps=[1.0, 1.0], accel_mps2=[0.0, 1.0], command_frac=[0.2, 0.3])
    assert len(calibration_of(other).value) == 2
    assert len(calibration_of(bench).value) > 100


def test_every_cell_is_held_out_once_and_what_is_done_is_not_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = load(ROOT / "bench_configs" / "mkz_complete.toml")
    cells: list[set[int]] = []

    def turn(points: Any, edges: Any, nominal: Any, which: tuple[int, int], seed: int) -> Any:
        out = [split_holdout(points[pedal], *which, np.random.default_rng([seed, 77]))[1] for pedal in PEDALS]
        cells.append(set(out[0].cell.tolist()))
        errors = {pedal: [0.1] * len(set(one.cell.tolist())) for pedal, one in zip(PEDALS, out, strict=True)}
        return {name: errors for name in (measure.LEARNED, measure.NETS, measure.BINNED, measure.NOMINAL)}

    monkeypatch.setattr(measure, "_turn", turn)
    samples = gather_samples([some_drive()], vehicle()).samples
    for _ in range(2):
        ledger = measure.Ledger(tmp_path)
        errors = measure.held_out_errors(samples, bench, None, 3, 1, ledger, {"files": ["a"]})
    assert len(cells) == 3, "the second call finds all turns"
    own = select_points(samples, {pedal: make_cell_edges(vehicle(), pedal) for pedal in PEDALS}, 1)[THROTTLE]
    assert set.union(*cells) == set(own.cell.tolist()) and sum(map(len, cells)) == len(set(own.cell.tolist()))
    assert len(errors[measure.LEARNED][THROTTLE]) == len(set(own.cell.tolist()))
