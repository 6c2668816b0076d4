"""The model folders: their numbers are ones that the plants take, and the noise fields exist."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import pytest

from tests.plant.drives import PLANTS
from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.bench.vehicle import plant_of
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.plant.data_sheet import DEFAULTS
from tunefree_hil.plant.measurement.sensors import noise_table
from tunefree_hil.plant.reference_vehicle.maps import MapShape

# Constants that make the published tables another vehicle's; the vehicle of the tables leaves them out
OTHER_SHAPE = ("throttle_scale", "brake_scale", *MapShape._fields, "drive_front_frac", "brake_front_frac")
FITTED = 0.1  # a calibrated steering ratio is the vehicle's own, which is near the data sheet's
# Neutral where a model does not say them: one that was learned before there were such constants
ALL_CARS = {"linkage_bend": 0.0, "overrun_force_n": 0.0, "drive_corner": 2.0, "brake_rise_per_frac": 0.0}
MODELS = Path(__file__).resolve().parents[2] / "bench_configs" / "models"


def model(name: str) -> dict:
    return tomllib.loads((MODELS / name / "model.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("name", "kind"), [("mkz_nominal", "physics"), ("mkz_reference", "reference")])
def test_model_folder(name: str, kind: str) -> None:
    said = model(name)
    assert said["plant"]["kind"] == kind
    params = said["plant"]["params"]
    assert PLANTS[kind].make(params, BodyChange()).params == PLANTS[kind].make({}, BodyChange()).params, (
        "the file states the defaults of the code; whoever changes one changes both"
    )
    assert set(PLANTS[kind].defaults) == set(params) | (set(OTHER_SHAPE) if kind == "reference" else set())


@pytest.mark.parametrize("path", sorted(MODELS.glob("*/model.toml")), ids=lambda path: path.parent.name)
def test_every_model_folder(path: Path) -> None:
    """A model says every constant of its plant, so that no default, which is another car's, is left in it."""
    said = model(path.parent.name)
    plant, params = plant_of(load_model(path.parent)), said["plant"]["params"]
    block = plant.make(params, BodyChange())
    car = getattr(block.params.constants, "car", block.params.constants)  # a learned plant has weights beside it
    constants = car._replace(power_w=0.0) if hasattr(car, "power_w") else car  # infinite: no effect caps it
    assert all(math.isfinite(value) for value in constants if isinstance(value, float))
    assert set(plant.defaults) - set(params) <= {*OTHER_SHAPE, *ALL_CARS}
    assert all(plant.defaults[name] == ALL_CARS[name] for name in set(ALL_CARS) & set(plant.defaults))
    noise_table(said["noise"], said.get("bias", {}), 1, 1)
    vehicle = load_vehicle(said["vehicle"]).nominal
    assert params["rest_pedal_frac"] == vehicle.rest_pedal_frac
    ratio = pytest.approx(vehicle.steer_ratio, rel=FITTED) if "card" in said["plant"] else vehicle.steer_ratio
    assert params["steer_ratio"] == ratio, "plant and controller would mean different angles"


def test_only_the_nominal_car_has_actuators_in_its_file() -> None:
    assert set(model("mkz_nominal")["actuators"]) == {"throttle", "brake", "steer"}
    assert "actuators" not in model("mkz_reference")
    assert PLANTS["reference"].actuators is not None and PLANTS["physics"].actuators is None


def test_the_two_cars_are_not_the_same() -> None:
    reference = PLANTS["reference"].defaults
    assert reference["mass_kg"] < DEFAULTS["mass_kg"]
    assert reference["front_stiffness_n_per_rad"] < reference["rear_stiffness_n_per_rad"]
