"""The steering map in `map`, `calibrate` and `learn`: written where the logs tell it, a warning where they do not."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import other_vehicle
from tests.house import ROOT
from tests.jobs.ended import ended
from tests.learn.steering_map.made_turns import TRUTH, VEHICLE, turning_drive, without
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.config.learned.steering_map_schema import load_steering_map
from tunefree_hil.config.load import load_model
from tunefree_hil.jobs.learn import map as map_job
from tunefree_hil.jobs.learn import steering as job
from tunefree_hil.jobs.learn.options import MapOptions
from tunefree_hil.learn.drives.drive import Drive

NOMINAL = ROOT / "bench_configs" / "models" / "mkz_nominal"
DRIVE = turning_drive(seconds=120.0)


def learned(drives: list[Drive], folder: Path) -> tuple[dict[str, Any], list[Event]]:
    return ended(job.learn_steering_of_logs(drives, VEHICLE, folder / "steering_map.toml", folder / "steering.png"))


def test_logs_that_tell_it_are_written_and_drawn(tmp_path: Path) -> None:
    data, events = learned([DRIVE], tmp_path)
    spec = load_steering_map(Path(data["steering_map"]))
    assert spec.coefficients.understeer_s2pm.value == pytest.approx(TRUTH.understeer_s2pm, abs=5e-5)
    assert spec.source.hashes == {"made": DRIVE.log_hash} and spec.notes
    assert Path(data["figures"][0]).read_bytes()[:4] == b"\x89PNG"
    assert any("understeer 0.004" in event.message for event in events if event.kind == "note")
    assert not any(event.kind == "warning" for event in events)


@pytest.mark.parametrize(
    ("drive", "why"),
    [
        (without(DRIVE, "ins.yaw_rate_radps"), "no yaw rate"),
        (turning_drive(seconds=10.0), "needed are 8"),
        (turning_drive(seconds=60.0, speeds_mps=(0.0, 0.0)), "needed are 8"),
    ],
)
def test_logs_that_do_not_are_a_warning_and_no_file(drive: Drive, why: str, tmp_path: Path) -> None:
    data, events = learned([drive], tmp_path)
    [warning] = [event.message for event in events if event.kind == "warning"]
    assert warning.startswith("no steering map: ") and why in warning
    assert data == {"figures": []} and list(tmp_path.iterdir()) == []


def test_a_vehicle_without_a_data_sheet_has_none(tmp_path: Path) -> None:
    from tunefree_hil.config.load import load_vehicle

    bare = load_vehicle("rav4_2017")
    steps = job.learn_steering_of_logs([DRIVE], bare, tmp_path / "a.toml", tmp_path / "a.png")
    data, events = ended(steps)
    assert data == {"figures": []} and [event.kind for event in events] == ["warning"]


def test_a_model_folder_gets_its_map_once(tmp_path: Path) -> None:
    folder = tmp_path / "own"
    shutil.copytree(NOMINAL, folder)
    before = load_model(folder).hash
    first = list(job.learn_steering_of_folder(folder, VEHICLE, [DRIVE]))
    text = (folder / "steering_map.toml").read_text()
    assert first and list(job.learn_steering_of_folder(folder, VEHICLE, [turning_drive(seed=9)])) == []
    assert (folder / "steering_map.toml").read_text() == text and load_model(folder).hash == before
    assert (folder / "figures" / "steering_map.png").is_file() and "axles of the model" in text
    other = tmp_path / "learned"
    other.mkdir()
    job.copy_steering_map(folder, other)
    job.copy_steering_map(NOMINAL, other)  # has none
    assert (other / "steering_map.toml").read_text() == text


def test_its_file_lies_beside_the_open_loop_map(tmp_path: Path) -> None:
    assert job.steering_target(tmp_path) == tmp_path / "steering_map.toml"
    assert job.steering_target(tmp_path / "calibration.npz") == tmp_path / "steering_map.toml"
    assert job.steering_target(tmp_path / "mine.npz") == tmp_path / "mine_steering.toml"


class TestModelInThePlaceOfLogs:
    @pytest.fixture(autouse=True)
    def _turns(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """The turns as if driven; tests/jobs/learn/test_steady_turns.py drives them."""
        monkeypatch.setattr("tunefree_hil.jobs.learn.steady_turns.drive_steady_turns", lambda bench: [DRIVE])

    def run(self, model: Path, out: Path) -> Iterator[Event]:
        return map_job.map_logs(MapOptions([model], "mkz_bywire", out))

    def test_it_is_driven_and_its_hash_recorded(self, tmp_path: Path) -> None:
        events = list(self.run(NOMINAL, tmp_path))
        data = events[-1].data
        spec = load_steering_map(Path(data["steering_map"]))
        assert spec.source.kind == "model"
        assert spec.source.hashes == {NOMINAL.name: f"sha256:{load_model(NOMINAL).hash}"}
        assert "understeer" in data["sentence"] and Path(data["figures"][0]).is_file()
        assert not (tmp_path / "calibration.npz").exists()

    def test_one_of_another_vehicle_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="the vehicle is"):
            list(self.run(other_vehicle.NOMINAL, tmp_path))

    def test_turns_that_tell_nothing_are_named(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        short = turning_drive(seconds=10.0)
        monkeypatch.setattr("tunefree_hil.jobs.learn.steady_turns.drive_steady_turns", lambda bench: [short])
        with pytest.raises(InputError) as caught:
            list(self.run(NOMINAL, tmp_path))
        assert caught.value.code == "no_steady_turns" and not (tmp_path / "steering_map.toml").exists()
