"""Replay, before and beside the drives: which files must be as they were, and which folders are episodes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, calibration_path, load
from tunefree_hil.jobs import replay
from tunefree_hil.jobs.identity import compute_identity
from tunefree_hil.jobs.run_folder import RunFolder


def refused(bench: Bench, run: RunFolder) -> str:
    """Why the run cannot be driven again."""
    with pytest.raises(InputError) as caught:
        replay._require_same_files(run, bench, bench.spec.model)
    return caught.value.message


def test_a_copy_that_a_person_made_is_not_driven_again(tmp_path: Path) -> None:
    run = RunFolder(tmp_path, {})
    for name in ("0", "old"):
        (tmp_path / "episodes" / name).mkdir(parents=True)
        (tmp_path / "episodes" / name / "vehicle.log").write_text("")
    assert replay._episode_numbers(run, None) == [0]


def test_another_map_or_module_than_the_run_s_is_said(tmp_path: Path) -> None:
    """Every frame would differ, and nobody would know why."""
    module = tmp_path / "mine.py"
    module.write_text("from tunefree_hil.control.lateral.lqr import CONTROLLER\n")
    nominal = calibration_path(load(write_bench(tmp_path))).read_bytes()
    (tmp_path / "own.npz").write_bytes(nominal)
    more = f'[controller]\nlateral = "{module}:CONTROLLER"\ncalibration = "own.npz"'
    bench = load(write_bench(tmp_path, more=more))
    run = RunFolder(tmp_path, compute_identity(bench, bench.spec.model, bench.scenarios.values()))
    replay._require_same_files(run, bench, bench.spec.model)
    (tmp_path / "own.npz").write_bytes(nominal + b" ")
    assert refused(bench, run).startswith("the open-loop map changed")
    module.write_text(module.read_text() + "\n")
    assert refused(bench, run).startswith("the open-loop map and the user modules changed")
    older = RunFolder(tmp_path, {"hashes": {"vehicle": bench.vehicle.hash}})
    replay._require_same_files(older, bench, bench.spec.model)
