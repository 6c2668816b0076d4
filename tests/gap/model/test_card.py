"""What a model's card says of the drives that it was not fitted on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.gap.model.card import HoldoutErrors, read_holdout_errors


def model_with(card: Any, folder: Path) -> ModelSpec:
    (folder / "card.json").write_text(json.dumps(card))
    model = load_model("mkz_nominal")
    return replace(model, folder=str(folder), plant=replace(model.plant, card="card.json"))


def test_what_was_missed_is_read_by_quantity_and_by_actuator(tmp_path: Path) -> None:
    card = {
        "actuators": {
            "brake": {"held_out_rms": 0.005, "noise": 0.003},
            "throttle": {"held_out_rms": 0.01},
            "steer": {},
        },
        "free_run_rms": {"held_out": {"fitted": {"yaw_rate_radps": 0.01, "speed_mps": 0.05, "x_m": None}}},
    }
    found = read_holdout_errors(model_with(card, tmp_path))
    assert found == HoldoutErrors(
        {"yaw_rate_radps": 0.01, "speed_mps": 0.05}, {"brake": (0.005, 0.003), "throttle": (0.01, 0.0)}
    )


@pytest.mark.parametrize("card", [{}, {"actuators": None}, {"free_run_rms": {"held_out": None}}])
def test_a_card_that_says_nothing_of_it_is_one(card: dict[str, Any], tmp_path: Path) -> None:
    assert read_holdout_errors(model_with(card, tmp_path)) == HoldoutErrors({}, {})
    assert read_holdout_errors(load_model("mkz_nominal")) == HoldoutErrors({}, {}), "nor is one needed"


@pytest.mark.parametrize(
    "card",
    [
        {"free_run_rms": {"held_out": {"fitted": {"speed_mps": "x"}}}},
        {"free_run_rms": 3},
        {"actuators": {"brake": 3}},
        {"actuators": {"brake": {"held_out_rms": [1]}}},
    ],
)
def test_a_card_that_nobody_wrote_is_one_message(card: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no card of a model") as caught:
        read_holdout_errors(model_with(card, tmp_path))
    assert caught.value.file == str(tmp_path / "card.json") and caught.value.hint
