"""Model folders of the learned kinds on a bench: driven with and without frames, the same bits; mistakes are named."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.bench.test_every_vehicle import first_benches
from tests.bench.test_simulator import STARTS, bench_of
from tests.plant.model_files import KINDS, NOMINAL, arrays_of, write_model
from tools.measures._in_process import InProcess
from tools.measures.parity import differing
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, VehicleFor, follower_of, is_heavy, model_of, parameters_of
from tunefree_hil.bench.batch import Batch
from tunefree_hil.bench.simulator import Job, Simulator
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.episode.columns import columns_from_frames
from tunefree_hil.plant.learned.weights_file import INPUTS

MKZ = next(path for path in first_benches() if path.stem.startswith("mkz"))


@pytest.fixture
def bench() -> Bench:
    return bench_of(MKZ, STARTS["on_the_path"])


@pytest.mark.parametrize("kind", KINDS)
def test_with_frames_and_without_it_is_the_same_drive(kind: str, bench: Bench, tmp_path: Path) -> None:
    model = str(write_model(tmp_path / kind, kind))
    scenario, values = bench.scenarios["short"], parameters_of(bench)
    drive = InProcess(bench, model).drive(scenario, values)
    follower = follower_of(bench, scenario, values)
    recording = columns_from_frames(drive.frames, bench.codec, follower, bench.dt_s, ticks=drive.ticks)
    ours = Simulator(bench, model).drive(Job(values, scenario))
    assert (ours.error, ours.ticks) == (drive.error, drive.ticks) and ours.ticks > 20
    assert differing(recording, ours.recording) == {}
    assert np.ptp(recording.columns["speed_mps"]) > 0.01


def test_two_folders_of_a_kind_are_two_cars_of_one_structure(bench: Bench, tmp_path: Path) -> None:
    """Weights are data: the steps are the same functions, so nothing is compiled for another folder."""
    makers = [VehicleFor(bench, str(write_model(tmp_path / str(seed), "hybrid", seed))) for seed in (1, 2)]
    first, second = (one.body.block for one in makers)
    assert first.params.chassis.constants.net != second.params.chassis.constants.net
    assert first.step.__code__ is second.step.__code__
    cells = [sorted(str(cell.cell_contents) for cell in step.__closure__ or ()) for step in (first.step, second.step)]
    assert "step_hybrid" in str(cells[0])
    drives = [
        Simulator(bench, str(tmp_path / seed)).drive(Job(parameters_of(bench), bench.scenarios["short"]))
        for seed in "12"
    ]
    assert differing(drives[0].recording, drives[1].recording)


@pytest.mark.compiled
@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", ["hybrid", "lstm"])
def test_compiled_it_is_the_plain_drive_and_the_next_folder_waits_for_no_compiler(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = bench_of(MKZ, STARTS["on_the_path"], 2.0)
    scenario, values = bench.scenarios["short"], parameters_of(bench)
    kernels = tmp_path / "cache"
    monkeypatch.setenv("TUNEFREE_CACHE", str(kernels))
    kept = []
    for seed in (1, 2):
        model = str(write_model(tmp_path / str(seed), kind, seed, width=8 if seed == 1 else 6))
        with Batch(bench, model) as batch:
            [driven] = batch.drive([Job(values, scenario)], columns=True)
        plain = Simulator(bench, model).drive(Job(values, scenario))
        assert driven.recording is not None and driven.ticks == plain.ticks
        assert differing(plain.recording, driven.recording) == {}
        kept.append(sorted(path.name for path in kernels.rglob("*.kernel")))
    assert kept[0] and kept[0] == kept[1]


def test_windows_of_twenty_cells_want_a_compiled_node(bench: Bench, tmp_path: Path) -> None:
    heavy = {kind: is_heavy(bench, str(write_model(tmp_path / kind, kind))) for kind in KINDS}
    assert heavy == {"hybrid": False, "lstm": False, "mlp": False, "paper": True, "rule_based": False}


def refused(bench: Bench, model: Path) -> InputError:
    with pytest.raises(InputError) as caught:
        VehicleFor(bench, str(model))
    assert str(model) in caught.value.file, "the file is named"
    assert caught.value.hint
    return caught.value


def test_a_folder_without_its_file(bench: Bench, tmp_path: Path) -> None:
    model = write_model(tmp_path / "lstm", "lstm")
    (model / "plant.npz").unlink()
    assert refused(bench, model).code == "no_plant_file"


def test_a_file_of_another_kind_and_one_of_other_inputs(bench: Bench, tmp_path: Path) -> None:
    model = write_model(tmp_path / "lstm", "lstm")
    text = (model / "model.toml").read_text()
    (model / "model.toml").write_text(text.replace('kind = "lstm"', 'kind = "hybrid"'))
    assert refused(bench, model).code == "other_plant_kind"
    (model / "model.toml").write_text(text)
    names = np.array([*INPUTS["lstm"][:-1], "lateral_accel_mps2"])
    np.savez(model / "plant.npz", allow_pickle=False, kind=np.array("lstm"), inputs=names, **arrays_of("lstm"))
    assert refused(bench, model).key == "inputs"


def test_a_file_that_its_kind_does_not_have(bench: Bench, tmp_path: Path) -> None:
    model = Path(shutil.copytree(NOMINAL, tmp_path / "own"))
    text = (model / "model.toml").read_text()
    (model / "model.toml").write_text(text.replace('kind = "physics"', 'kind = "physics"\nfile = "plant.npz"'))
    assert refused(bench, model).key == "plant.file"


def test_a_model_of_the_vehicle_as_it_was(bench: Bench, tmp_path: Path) -> None:
    model = write_model(tmp_path / "lstm", "lstm")
    text = (model / "model.toml").read_text()
    line = 'vehicle = "mkz_bywire"\n'

    def say(vehicle_hash: str) -> None:
        (model / "model.toml").write_text(text.replace(line, f'{line}vehicle_hash = "{vehicle_hash}"\n'))

    say("sha256:" + "0" * 64)
    error = refused(bench, model)
    assert (error.code, error.key) == ("vehicle_changed", "vehicle_hash")
    say("sha256:" + load_vehicle("mkz_bywire").hash)
    assert model_of(bench, str(model)).plant.kind == "lstm"


def test_an_effect_that_a_network_cannot_show(tmp_path: Path, bench: Bench) -> None:
    effect = '[[effects]]\nname = "power_limit"\nparams = { power_w = 3e4 }\n'
    model = write_model(tmp_path / "mlp", "mlp", more=effect)
    assert refused(bench, model).code == "not_in_this_plant"
    VehicleFor(bench, str(write_model(tmp_path / "hybrid", "hybrid", more=effect)))
