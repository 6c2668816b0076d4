"""`map`: a log in, a calibration.npz out that the controller loads; what is wrong is one message."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import other_vehicle
from tests.house import ROOT
from tests.jobs.made_runs import made_drive
from tests.learn.made_pedals import changed, pedal_drive, some_drive, vehicle
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.control.calibration_map import load, lookup
from tunefree_hil.jobs.learn import map as job
from tunefree_hil.jobs.learn.options import MapOptions
from tunefree_hil.learn.training import map_nets

MODELS = ROOT / "bench_configs" / "models"


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Drives in the place of what would be read from logs; fill it."""
    drives: list[Any] = []

    def read(logs: Any, spec: Any) -> Any:
        yield Event("note", "read")
        return drives

    monkeypatch.setattr(job, "read_logs", read)
    return drives


def run(out: Path, **options: Any) -> tuple[list[Event], dict[str, Any]]:
    events = list(job.map_logs(MapOptions([Path("a.log")], "mkz_bywire", out, **options)))
    assert events[-1].kind == "result"
    return events, events[-1].data


def test_a_missing_torch_is_said_before_anything_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match="torch"):
        list(job.map_logs(MapOptions([tmp_path / "no.log"], "mkz_bywire", tmp_path / "out")))


def test_targets(tmp_path: Path) -> None:
    assert job.resolve_target(tmp_path / "a.npz", vehicle()) == tmp_path / "a.npz"
    assert job.resolve_target(tmp_path / "new", vehicle()) == tmp_path / "new" / "calibration.npz"
    assert job.resolve_target(MODELS / "mkz_nominal", vehicle()).name == "calibration.npz"
    with pytest.raises(InputError, match=f"is a model of '{other_vehicle.NAME}'"):
        job.resolve_target(other_vehicle.NOMINAL, vehicle())
    old = shutil.copytree(MODELS / "mkz_nominal", tmp_path / "old")
    (old / "model.toml").write_text('vehicle_hash = "sha256:00"\n' + (old / "model.toml").read_text())
    with pytest.raises(InputError, match="was made before the folder"):
        job.resolve_target(old, vehicle())
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(InputError, match="is a file"):
        job.resolve_target(tmp_path / "notes.txt", vehicle())


class TestTraining:
    @pytest.fixture(autouse=True)
    def _torch(self, monkeypatch: pytest.MonkeyPatch) -> None:
        pytest.importorskip("torch", reason="the extra `learn` is not installed")
        monkeypatch.setattr(map_nets, "HIDDEN_WIDTHS", (8,))
        monkeypatch.setattr(map_nets, "N_SEEDS", 1)
        monkeypatch.setattr(map_nets, "MAX_ROUNDS", 10)

    @pytest.mark.slow
    def test_a_model_folder_gets_its_map(self, made: list[Any], tmp_path: Path) -> None:
        folder = tmp_path / "mkz_nominal"
        shutil.copytree(MODELS / "mkz_nominal", folder)
        made.append(some_drive())
        events, data = run(folder)
        own = load(folder / "calibration.npz")
        assert lookup(own, 6.0, 1.0) > 0.15 and lookup(own, 6.0, -2.0) < -0.15
        assert data["replaced_mps2"] > 0.2 and "the map it replaces" in data["sentence"]
        assert data["monotone"] and data["schema"] == "tunefree.map/1"
        assert sum(event.kind == "progress" for event in events) == 2
        assert all(Path(figure).read_bytes()[:4] == b"\x89PNG" for figure in data["figures"])
        with np.load(folder / "calibration.npz") as archive:
            assert json.loads(str(archive["card"]))["logs"] == {"made.log": "sha256:made"}

    def test_drives_that_do_not_do_are_refused_before_training(self, made: list[Any], tmp_path: Path) -> None:
        made[:] = [pedal_drive(120.0, brakes=False)]
        with pytest.raises(InputError, match="no braking"):
            run(tmp_path)
        drive = some_drive()
        throttle, brake = drive.fields["command.throttle_frac"], drive.fields["command.brake_frac"]
        made[:] = [changed(drive, command__throttle_frac=brake, command__brake_frac=throttle)]
        with pytest.raises(InputError, match="swapped"):
            run(tmp_path)
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.slow
    def test_a_bench_drives_by_the_map_of_its_own_logs(self, tmp_path: Path) -> None:
        """From candump logs of a real drive in one process; two scenarios have few cells, so its words are checked."""
        bench = tmp_path / "straight.toml"
        text = (ROOT / "bench_configs" / "mkz_steer.toml").read_text()
        begin, end = text.index("scenarios ="), text.index("]", text.index("scenarios =")) + 1
        bench.write_text(text[:begin] + 'scenarios = ["speed_changes", "stop_and_go"]' + text[end:])
        made_run = made_drive(bench, tmp_path, "drive", {})
        logs = sorted(made_run.glob("episodes/*/vehicle.log"))
        assert len(logs) == 2
        events = list(job.map_logs(MapOptions(logs, "mkz_bywire", tmp_path / "own.npz")))
        own = load(tmp_path / "own.npz")
        nominal = load(MODELS / "mkz_nominal" / "calibration.npz")
        for speed, accel in ((6.0, 1.0), (8.0, -1.2)):
            assert lookup(own, speed, accel) == pytest.approx(lookup(nominal, speed, accel), abs=0.03)
        assert any("controller] calibration" in event.message for event in events)
