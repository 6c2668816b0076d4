"""What the card in a model's folder says of how the model was made (docs/learning.md)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec

OWN_NUMBERS = "own_numbers"  # gap/estimation/calibration_priors.py


class HeldOut(NamedTuple):
    """What a calibration missed of drives that it was not fitted on, root mean square: by quantity of the motion, and
    by actuator (missed, of that noise). Nothing of what nobody said.
    """

    motion: Mapping[str, float]
    actuators: Mapping[str, tuple[float, float]]


def card_of(model: ModelSpec) -> dict[str, Any]:
    """What the card in a model's folder says; empty where the model names none. Raises InputError for one that is not
    there, or is none.
    """
    if not model.plant.card or not model.folder:
        return {}
    path = Path(model.folder) / model.plant.card
    if not path.is_file():
        raise InputError(
            f"the model's card, {path.name}, is not there", code="no_card", file=f"{model.folder}/model.toml",
            key="plant.card", hint="put it back, calibrate the model again, or take the key out",
        )  # fmt: skip
    return read_card(path)


def read_card(path: Path) -> dict[str, Any]:
    """The table in a card's file. Raises InputError for one that nobody's command wrote."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise no_card(path, error) from error
    if not isinstance(found, dict):
        raise no_card(path, "no table")
    return found


def no_card(path: Path, why: object) -> InputError:
    """For a card that nobody's command wrote."""
    return InputError(
        f"this is no card of a model: {why}", code="bad_card", file=str(path), hint="calibrate the model again"
    )


def held_out_of(model: ModelSpec) -> HeldOut:
    """Read off the model's card. Raises InputError for one that is none."""
    card = card_of(model)
    try:
        runs = ((card.get("free_run_rms") or {}).get("held_out") or {}).get("fitted") or {}
        told = {name: one for name, one in (card.get("actuators") or {}).items() if one.get("held_out_rms")}
        return HeldOut(
            {name: float(rms) for name, rms in runs.items() if rms is not None},
            {name: (float(one["held_out_rms"]), float(one.get("noise") or 0.0)) for name, one in told.items()},
        )
    except (AttributeError, TypeError, ValueError) as error:
        raise no_card(Path(model.folder) / model.plant.card, error) from error
