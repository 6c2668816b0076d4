"""A model that makes no car is refused by file and key before a log is read, and nothing is written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.gap.made_answer import VEHICLE
from tests.jobs.gap.test_calibration_logs import folder_of
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.find import CHECKOUT
from tunefree_hil.jobs.gap.calibration_logs import ANALYSED_KEY, list_analysis_warnings
from tunefree_hil.jobs.gap.gap import load_checked_model, run_gap
from tunefree_hil.jobs.gap.options import GapOptions
from tunefree_hil.learn.model_folder import CARD_FILE

EFFECT = '[[effects]]\nname = "{}"\n[effects.params]\n{}\n'
DELAY = EFFECT.format("steer_dead_time", "delay_s = 0.1")


def changed(folder: Path, more: str = "", kind: str = "physics") -> Path:
    """A model folder with something at the end of its model.toml, and of another kind."""
    file = folder_of(folder) / "model.toml"
    text = file.read_text().replace('kind = "physics"', f'kind = "{kind}"').replace("effects = []\n", "")
    file.write_text(f"{text}\n{more}")
    return folder


@pytest.mark.parametrize(
    ("more", "key", "said"),
    [
        ({"more": EFFECT.format("steer_dead_tim", "delay_s = 0.1")}, "effects[0].name", "mean steer_dead_time"),
        ({"more": EFFECT.format("no.py:EFFECT", "a = 1.0")}, "effects[0].name", "no.py does not exist"),
        ({"more": EFFECT.format(f"{__file__}:DELAY", "a = 1.0")}, "effects[0].name", "type str, where Effect is"),
        ({"more": DELAY + EFFECT.format("steer_dead_time", "dely_s = 0.1")}, "effects[1].params.dely_s", "delay_s [s]"),
        ({"more": EFFECT.format("steer_dead_time", "delay_s = -0.1")}, "effects[0].params.delay_s", "delay_s = -0.1"),
        ({"more": EFFECT.format("steer_dead_time", "delay_s = inf")}, "effects[0].params.delay_s", "must be finite"),
        ({"more": DELAY + EFFECT.format("payload", "mass_kg = -9000.0")}, "effects[1]", "-9000.0 kg of payload"),
        ({"kind": "physix"}, "plant.kind", "there are physics, reference"),
        ({"kind": "reference"}, "plant.kind", "cannot take over a measured motion"),
    ],
)
def test_what_makes_no_car_is_refused_by_its_key(more: dict[str, Any], key: str, said: str, tmp_path: Path) -> None:
    folder = changed(tmp_path / "model", **more)
    refused(folder, tmp_path / "out", key, said)


@pytest.mark.parametrize(
    ("params", "key", "said"),
    [
        ({"mas_kg": 1460.0}, "mas_kg", "it has mass_kg"),
        ({"mass_kg": -1460.0}, "mass_kg", "expected more than 0, got -1460"),
        ({"front_stiffness_n_per_rad": 0.0}, "front_stiffness_n_per_rad", "expected more than 0, got 0"),
        ({"drag_area_m2": -0.1}, "drag_area_m2", "expected 0 or more"),
        ({"drive_power_w": float("inf")}, "drive_power_w", "no number of a car"),
        ({"front_axle_m": 9.0}, "front_axle_m", "not more than front_axle_m, which is 9"),
    ],
)
def test_a_constant_that_no_car_has_is_refused(params: dict[str, float], key: str, said: str, tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "model")
    with (folder / "model.toml").open("a") as file:
        file.write("[plant.params]\n" + "".join(f"{name} = {value}\n" for name, value in params.items()))
    refused(folder, tmp_path / "out", f"plant.params.{key}", said)


def test_what_calibrate_and_gap_write_of_a_car_without_a_brake_or_a_pedal_that_begins_early_is_sound(
    tmp_path: Path,
) -> None:
    folder = folder_of(tmp_path / "model")
    with (folder / "model.toml").open("a") as file:
        file.write("[plant.params]\nbrake_force_n_per_frac = 0.0\nthrottle_zero_frac = -0.01\n")
    load_checked_model(str(folder), VEHICLE)


def refused(folder: Path, out: Path, key: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        next(iter(run_gap(GapOptions([Path("no.log")], VEHICLE.folder, str(folder), out))))
    assert (caught.value.file, caught.value.key) == (str(folder / "model.toml"), key)
    assert said in f"{caught.value.message} {caught.value.hint}" and caught.value.hint and not out.exists()


def test_a_card_that_is_named_must_be_there_and_be_one(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "model")
    (folder / CARD_FILE).write_text("half of")
    with pytest.raises(InputError, match="no card of a model"):
        load_checked_model(str(folder), VEHICLE)
    (folder / CARD_FILE).unlink()
    refused(folder, tmp_path / "out", "plant.card", "take the key out")


@pytest.mark.parametrize("name", sorted(one.parent.name for one in CHECKOUT.glob("bench_configs/models/*/model.toml")))
def test_the_models_of_the_checkout_are_sound_but_for_the_reference(name: str) -> None:
    from tunefree_hil.config.load import load_model, load_vehicle

    vehicle = load_vehicle(load_model(name).vehicle)
    if name.endswith("_reference"):
        with pytest.raises(InputError, match="measured motion"):
            load_checked_model(name, vehicle)
    else:
        assert not list(list_analysis_warnings(load_checked_model(name, vehicle)))


def test_a_model_whose_calibration_was_cut_off_is_said_to_be_one(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "model")
    rms = {"training": {"fitted": {"speed_mps": 0.1}}}
    card = {"constants": {}, "free_run_rms": rms}
    (folder / CARD_FILE).write_text(json.dumps(card))
    (said,) = list_analysis_warnings(load_checked_model(str(folder), VEHICLE))
    assert "were not analysed" in said and str(folder) in said
    (folder / CARD_FILE).write_text(json.dumps({**card, ANALYSED_KEY: True}))
    assert not list(list_analysis_warnings(load_checked_model(str(folder), VEHICLE)))
