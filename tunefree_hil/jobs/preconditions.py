"""What several jobs refuse before they begin."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench.load import require_current

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec

LOGS, VEHICLE = "the logs are of", "the vehicle is"


def require_model_of(
    model: ModelSpec, vehicle: VehicleSpec, key: str = "vehicle", *, hint: str, file: str = "", needed: str = LOGS
) -> None:
    """Raises InputError for a model of another vehicle, and for one of this vehicle before its folder was changed.

    key, file: where it was named, '' for the model's own file; needed: what says which vehicle it has to be.
    """
    if model.vehicle != vehicle.name:
        raise InputError(
            f"is a model of {model.vehicle!r}, {needed} {vehicle.name!r}",
            code="model_of_other_vehicle",
            file=file or f"{model.folder}/model.toml",
            key=key,
            hint=hint,
        )
    require_current(model, vehicle)


def require_number(key: str, value: float | None, *, most: float, zero: bool = False) -> None:
    """Raise InputError for an option that is no number above 0 (with `zero`: from 0 on) to `most`; None: not given."""
    if value is None or (math.isfinite(value) and 0.0 <= value <= most and (zero or value > 0.0)):
        return
    hint = f"give a number {'from' if zero else 'above'} 0, {most:g} at most"
    raise InputError(f"{key} {value:g} does not do", code="usage", key=key, hint=hint)
