"""Checks that several jobs make before they start."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench.load import require_current

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec

LOGS_ARE_OF, VEHICLE_IS = "the logs are of", "the vehicle is"


class ErrorPlace(NamedTuple):
    """Where an error is, and what to do. file: '' for the model's own file."""

    hint: str
    key: str = "vehicle"
    file: str = ""


def require_model_of_vehicle(
    model: ModelSpec, vehicle: VehicleSpec, place: ErrorPlace, needed: str = LOGS_ARE_OF
) -> None:
    """Raise InputError for a model of another vehicle, or of an earlier state of the vehicle folder.

    Args:
        place: Where the model was named.
        needed: What determines the vehicle, for the message.
    """
    if model.vehicle != vehicle.name:
        raise InputError(
            f"is a model of {model.vehicle!r}, {needed} {vehicle.name!r}",
            code="model_of_other_vehicle",
            file=place.file or f"{model.folder}/model.toml",
            key=place.key,
            hint=place.hint,
        )
    require_current(model, vehicle)


def require_number(key: str, value: float | None, *, maximum: float, allow_zero: bool = False) -> None:
    """Raise InputError for an option that is not in (0, most], or with `zero` in [0, most]. None is accepted."""
    if value is None or (math.isfinite(value) and 0.0 <= value <= maximum and (allow_zero or value > 0.0)):
        return
    hint = f"give a number {'from' if allow_zero else 'above'} 0, {maximum:g} at most"
    raise InputError(f"{key} {value:g} is out of range", code="usage", key=key, hint=hint)
