"""What several jobs refuse before they begin."""

from __future__ import annotations

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
