"""The card in a model's folder: how the model was made (docs/explanation/learning.md)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec

CALIBRATION_PRIORS_KEY = "own_numbers"  # written by gap/estimation/calibration_priors.py


class HoldoutErrors(NamedTuple):
    """RMS errors of a calibration on drives that it was not fitted on; only what the card has.

    Args:
        motion: by quantity of the motion.
        actuators: by actuator, its error and the noise in that.
    """

    motion: Mapping[str, float]
    actuators: Mapping[str, tuple[float, float]]


def load_model_card(model: ModelSpec) -> dict[str, Any]:
    """The card of a model; empty if the model names none.

    Raises:
        InputError: the card is missing or invalid.
    """
    if not model.plant.card or not model.folder:
        return {}
    path = Path(model.folder) / model.plant.card
    if not path.is_file():
        raise InputError(
            f"the model's card, {path.name}, is not there",
            code="no_card",
            file=f"{model.folder}/model.toml",
            key="plant.card",
            hint="put it back, calibrate the model again, or take the key out",
        )
    return read_card(path)


def read_card(path: Path) -> dict[str, Any]:
    """The table in a card's file.

    Raises:
        InputError: the file is no valid card.
    """
    try:
        card = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise card_error(path, error) from error
    if not isinstance(card, dict):
        raise card_error(path, "no table")
    return card


def card_error(path: Path, reason: object) -> InputError:
    """The error for a file that is no valid card."""
    return InputError(
        f"this is no card of a model: {reason}", code="bad_card", file=str(path), hint="calibrate the model again"
    )


def read_holdout_errors(model: ModelSpec) -> HoldoutErrors:
    """The holdout errors in a model's card.

    Raises:
        InputError: the card is invalid.
    """
    card = load_model_card(model)
    try:
        runs = ((card.get("free_run_rms") or {}).get("held_out") or {}).get("fitted") or {}
        actuators = {name: entry for name, entry in (card.get("actuators") or {}).items() if entry.get("held_out_rms")}
        return HoldoutErrors(
            {name: float(rms) for name, rms in runs.items() if rms is not None},
            {
                name: (float(entry["held_out_rms"]), float(entry.get("noise") or 0.0))
                for name, entry in actuators.items()
            },
        )
    except (AttributeError, TypeError, ValueError) as error:
        raise card_error(Path(model.folder) / model.plant.card, error) from error
