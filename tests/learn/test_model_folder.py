"""A model folder is written whole or not at all, and is read as it was meant."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.plant.model_files import arrays_of
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.config.schema import value_of
from tunefree_hil.learn.estimate import ActuatorFit, Estimate, make_exact_estimate, make_unidentified_estimate
from tunefree_hil.learn.model_folder import ModelContent, write_model
from tunefree_hil.plant.learned.weights_file import load_plant_file

LIMIT = make_unidentified_estimate(math.inf, "never reached", low=3.0, high=math.inf)
LAG = make_exact_estimate(0.0), Estimate(3.0, 2.9, 3.1), Estimate(0.7, 0.6, 0.8)
FIT = ActuatorFit(
    Estimate(0.1, 0.09, 0.11),
    2,
    *LAG,
    LIMIT,
    make_exact_estimate(0.0),
    make_exact_estimate(1.0),
    make_exact_estimate(0.0),
)


def write(folder: Path, **changed: Any) -> Path:
    given: dict[str, Any] = {
        "kind": "physics",
        "actuators": {"steer": FIT},
        "params": {"mass_kg": 2000.0, "steer_ratio": Estimate(15.9, 15.7, 16.1)},
        "valid": {"speed_mps": (0.0, 12.0)},
        "noise": {"report.speed_mps": np.float64(0.01)},
    }
    card = {"rows": np.arange(3), "best": math.nan}
    return write_model(folder, load_vehicle("mkz_bywire"), ModelContent(**{**given, **changed}), card)


def test_it_is_read_back_as_it_was_given(tmp_path: Path) -> None:
    model = load_model(write(tmp_path / "new"))
    steer = model.actuators["steer"]
    assert (steer.order, value_of(steer.natural_hz), value_of(steer.rate_limit)) == (2, 3.0, math.inf)
    assert model.vehicle_hash == f"sha256:{load_vehicle('mkz_bywire').hash}"
    assert model.plant.params == {"mass_kg": 2000.0, "steer_ratio": 15.9}
    assert model.valid.speed_mps == [0.0, 12.0] and model.noise == {"report.speed_mps": 0.01}
    assert json.loads((tmp_path / "new" / model.plant.card).read_text()) == {"rows": [0, 1, 2], "best": None}
    assert model.plant.file == "" and list(tmp_path.iterdir()) == [tmp_path / "new"]


def test_arrays_and_effects_go_with_it(tmp_path: Path) -> None:
    effect = {"name": "steer_offset", "params": {"offset_rad": 0.02}}
    given = {"kind": "lstm", "plant_arrays": arrays_of("lstm"), "calibration": {"speed_mps": np.ones(2)}}
    folder = write(tmp_path / "new", **given, effects=[effect])
    assert load_model(folder).effects[0].params == {"offset_rad": 0.02} and load_model(folder).plant.file == "plant.npz"
    net = load_plant_file(folder / "plant.npz", "lstm")
    assert all((net.arrays[name] == one).all() for name, one in arrays_of("lstm").items())
    assert sorted(path.name for path in folder.iterdir()) == ["calibration.npz", "card.json", "model.toml", "plant.npz"]


def test_arrays_that_make_no_plant_leave_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected float64"):
        write(tmp_path / "new", kind="lstm", plant_arrays=arrays_of("lstm") | {"w_out": arrays_of("lstm")["w_out"].T})
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_there_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "mine").write_text("kept")
    with pytest.raises(InputError, match="exists already"):
        write(tmp_path / "old")
    assert [path.name for path in tmp_path.rglob("*")] == ["old", "mine"]


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    (tmp_path / "new").mkdir()
    assert load_model(write(tmp_path / "new")).plant.kind == "physics"


def test_what_does_not_fit_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        write(tmp_path / "new", noise={"report.no_such": 0.1})
    assert not list(tmp_path.iterdir())
