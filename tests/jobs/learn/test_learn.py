"""The job `learn` on drives that are made in the test: what it writes, what it refuses, how it goes on."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from tests import other_vehicle
from tests.learn.made_drives import made_drive
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import EffectSpec
from tunefree_hil.jobs.learn import learn as job
from tunefree_hil.jobs.learn.learn import KINDS, build_command, learn, report_result
from tunefree_hil.jobs.learn.options import LearnOptions
from tunefree_hil.learn import model_folder
from tunefree_hil.learn.compiled_process import make_request, run_request
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.model_folder import (
    CALIBRATION_EFFECTS,
    CALIBRATION_LOGS,
    LearnedModel,
    fit_from_spec,
    select_plant_params,
    write_learned_model,
)

TRUTH = {"drive_force_n": 5200.0, "brake_force_n_per_frac": 70000.0, "rolling_frac": 0.02}


class Here:
    """A worker that works in this process: nothing is compiled."""

    def __enter__(self) -> Here:
        return self

    def __exit__(self, *_: object) -> None: ...

    def wait_for_result(self, function: Any, *args: Any) -> Any:
        *_, last = run_request(make_request(function, args))
        assert last.kind == "result", last.value
        return last.value


@pytest.fixture(scope="module")
def drives() -> list[Drive]:
    return [made_drive(26.0, seed=seed, params=TRUTH, name=f"drive {seed}") for seed in (1, 2, 3)]


@pytest.fixture
def asked(repo: Path, tmp_path: Path, drives: list[Drive], monkeypatch: pytest.MonkeyPatch) -> LearnOptions:
    """A wish whose logs are the made drives, and whose physics is the nominal car."""

    def read(logs: Any, vehicle: Any, tolerated: Any = ()) -> Iterator[Event]:
        yield Event("note", "made drives")
        return drives

    monkeypatch.setattr(job, "read_logs", read)
    monkeypatch.setattr(job, "FREE_RUN_STARTS", 2)
    monkeypatch.setattr(model_folder, "CompiledProcess", Here)
    models = repo / "bench_configs" / "models"
    return LearnOptions(
        [Path("a.log")], str(repo / "dbc" / "mkz_bywire"), tmp_path / "model", "mlp", 1, 0.005, models / "mkz_nominal"
    )


def test_without_torch_it_says_what_to_install(asked: LearnOptions, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError) as caught:
        list(learn(asked))
    assert caught.value.code == "no_torch" and "pip install '.[learn]'" in caught.value.hint


def test_importing_the_job_needs_no_torch() -> None:
    code = "import sys, tunefree_hil.jobs.learn.learn, tunefree_hil.cli.app; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_numbers_that_are_none_are_refused_before_training(
    asked: LearnOptions, drives: list[Drive], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    speed = drives[0].fields["ins.speed_mps"].copy()
    speed[500:600] = np.nan
    spoilt = drives[0]._replace(fields={**drives[0].fields, "ins.speed_mps": speed})
    monkeypatch.setattr("tunefree_hil.learn.drives.read.read_drives", lambda *_, **__: [spoilt, *drives[1:]])
    with pytest.raises(InputError, match=r"ins\.speed_mps"):
        list(learn(asked))


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 1e308])
def test_times_that_are_no_numbers_are_refused(
    asked: LearnOptions, value: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A range of the command line lets NaN through."""
    monkeypatch.setattr("tunefree_hil.learn.training.torch_extra.require_torch", lambda what: None)
    for change in ({"minutes": value}, {"sample_spacing_s": value, "kind": "paper"}):
        with pytest.raises(InputError, match="out of range") as caught:
            list(learn(asked._replace(**change)))
        assert caught.value.key in ("--minutes", "--sample-spacing")


def test_other_refusals(asked: LearnOptions, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no kind 'gru'"):
        list(learn(asked._replace(kind="gru")))
    with pytest.raises(InputError, match=other_vehicle.NAME):
        list(learn(asked._replace(physics=Path(str(asked.physics).replace("mkz", "van")))))
    old = shutil.copytree(str(asked.physics), tmp_path / "old")
    text = (old / "model.toml").read_text()
    (old / "model.toml").write_text('vehicle_hash = "sha256:00"\n' + text)
    with pytest.raises(InputError, match="was made before the folder"):
        list(learn(asked._replace(physics=old)))
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "model.toml").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        list(learn(asked))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mlp", "hybrid"])
def test_a_folder_comes_out_that_drives(kind: str, asked: LearnOptions) -> None:
    events = list(learn(asked._replace(kind=kind, minutes=0.02)))
    model = load_model(asked.out)
    assert model.plant.kind == kind and model.plant.file == "plant.npz"
    assert sorted(model.actuators) == ["brake", "steer", "throttle"]
    card = json.loads((asked.out / "card.json").read_text())
    assert card["split"].startswith("1 of 3 drives held out") and len(card["logs"]) == 3
    assert card["free_run"][kind]["level"]["starts"] == card["free_run"]["physics"]["level"]["starts"] > 0
    assert card["training"]["steps"] > 0 and card["versions"]["torch"]
    assert (asked.out / "figures" / "free_run.png").stat().st_size > 10_000
    assert (asked.out / "plant.npz").stat().st_size < 200_000
    assert events[-1].kind == "result" and str(asked.out) in events[-1].data["sentence"]
    assert not asked.out.with_name("model.part").exists()
    (asked.out / "figures" / "free_run.png").unlink()
    (once_more,) = report_result(asked._replace(kind=kind))
    assert once_more == events[-1] and (asked.out / "figures" / "free_run.png").is_file()


def test_a_folder_written_from_a_folder_keeps_what_is_known(repo: Path, tmp_path: Path) -> None:
    from tunefree_hil.config.load import load_vehicle

    vehicle = load_vehicle(repo / "dbc" / "mkz_bywire")
    physics = load_model(repo / "bench_configs" / "models" / "mkz_nominal")
    write_learned_model(tmp_path / "copy", LearnedModel("physics", vehicle, physics), {})
    copy = load_model(tmp_path / "copy")
    assert copy.noise == physics.noise and copy.valid == physics.valid and copy.timing == physics.timing
    assert {name: fit_from_spec(spec) for name, spec in copy.actuators.items()} == {
        name: fit_from_spec(spec) for name, spec in physics.actuators.items()
    }
    assert select_plant_params("hybrid", physics) == physics.plant.params
    assert set(select_plant_params("paper", physics, 0.05)) > {"wheelbase_m", "sample_spacing_s"}


def test_a_latency_that_the_own_logs_told_is_in_the_net_that_they_taught(repo: Path, tmp_path: Path) -> None:
    from tunefree_hil.config.load import load_vehicle

    vehicle = load_vehicle(repo / "dbc" / "mkz_bywire")
    physics = load_model(repo / "bench_configs" / "models" / "mkz_nominal")
    told = [
        EffectSpec(name=name, params={key: 0.02}, provenance={"by": by})
        for name, key, by in (
            ("ins_latency", "delay_s", CALIBRATION_LOGS),
            ("report_latency", "delay_s", "a person"),
            ("accel_bias", "bias_mps2", CALIBRATION_LOGS),
        )
    ]
    physics = msgspec.structs.replace(physics, effects=told)
    write_learned_model(tmp_path / "physics", LearnedModel("physics", vehicle, physics), {})
    assert [one.name for one in load_model(tmp_path / "physics").effects] == [one.name for one in told]
    with np.load(repo / "bench_configs" / "models" / "mkz_learned" / "plant.npz") as net:
        arrays = {name: net[name] for name in net.files if name not in ("kind", "inputs")}
    write_learned_model(tmp_path / "net", LearnedModel("hybrid", vehicle, physics, arrays), {})
    kept = load_model(tmp_path / "net").effects
    assert [(one.name, one.provenance["by"]) for one in kept] == [
        ("report_latency", "a person"),
        ("accel_bias", CALIBRATION_LOGS),
    ]


def test_the_command_that_goes_on(asked: LearnOptions) -> None:
    words = build_command(asked._replace(minutes=2.0, sample_spacing_s=0.05, kind="paper"))
    assert "--kind paper" in words and "--minutes 2" in words and "--sample-spacing 0.05" in words
    assert set(KINDS) == {"hybrid", "lstm", "mlp", "rule_based", "paper"}


def test_a_share_of_the_road_is_taken_from_a_calibration_on_the_same_logs_only(
    tmp_path: Path, drives: list[Drive]
) -> None:
    card = {"seed": 1, "logs": [{"hash": one.log_hash} for one in drives]}
    for share, taken in (({"value": 0.8, "known": True}, 0.8), ({"value": 0.8, "known": False}, 0.0), (None, 0.0),
                         ({"value": 1.3, "known": True}, 1.0)):  # fmt: skip
        constants = {} if share is None else {"road_share": share}
        (tmp_path / "card.json").write_text(json.dumps({**card, "constants": constants}), encoding="utf-8")
        assert job.read_road_share(tmp_path, drives) == taken
        assert job.read_road_share(tmp_path, drives[:2]) == 0.0
    assert job.read_road_share(tmp_path / "none", drives) == 0.0


def test_a_card_that_is_no_text_is_one_message(tmp_path: Path) -> None:
    """Of a folder that a person named by --physics."""
    (tmp_path / "card.json").write_bytes(b'{"by": "Stra\xdfe"}')
    for asks in (job.read_road_share, job.read_own_effects):
        with pytest.raises(InputError, match="no card of a model") as caught:
            asks(tmp_path, [])
        assert caught.value.file == str(tmp_path / "card.json")


def test_what_explains_the_logs_beside_the_physics_is_that_of_the_very_same_logs_only(
    tmp_path: Path, drives: list[Drive]
) -> None:
    there = {CALIBRATION_EFFECTS: {"accel_bias": {"bias_mps2": {"value": 0.1, "deviation": 0.01}}}}
    card = {"seed": 1, "logs": [{"hash": one.log_hash} for one in drives]}
    (tmp_path / "card.json").write_text(json.dumps({**card, **there}), encoding="utf-8")
    assert job.read_own_effects(tmp_path, drives) == there
    assert job.read_own_effects(tmp_path, drives[:2]) == {} == job.read_own_effects(tmp_path / "none", drives)
    (tmp_path / "card.json").write_text(json.dumps(card), encoding="utf-8")
    assert job.read_own_effects(tmp_path, drives) == {}
