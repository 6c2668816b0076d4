"""Checks that a model can be built: its plant, effects and card are made once before a log is read.

Later, deep inside a search, an error could no longer name the file and the key that are wrong.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tunefree_hil.base.contracts import BodyChange, Port
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.parts import names
from tunefree_hil.plant.constants import require_constants

if TYPE_CHECKING:
    from tunefree_hil.config.schema import EffectSpec, ModelSpec, VehicleSpec
    from tunefree_hil.plant.types import Plant

EFFECTS = "tunefree_hil.effects"
UNKNOWN_PART = "unknown_part"  # base/parts.py


def require_buildable_model(model: ModelSpec, vehicle: VehicleSpec) -> None:
    """Raise InputError that names model.toml (or the card) and the key that is wrong."""
    file = f"{model.folder}/model.toml"
    try:
        plant = _load_plant(model)
        require_constants(model.plant.kind, plant.defaults, model.plant.params)
        plant.make(model.plant.params, BodyChange())
        _require_effects(plant, model, vehicle, file)
    except InputError as error:
        error.file = error.file or file
        raise
    _require_card(model)


def _load_plant(model: ModelSpec) -> Plant:
    """The plant, of a kind that can be set to a measured motion. Raises InputError for any other kind."""
    from tunefree_hil.bench.vehicle import load_plant
    from tunefree_hil.learn.evaluation.free_run import open_plant

    load_plant(model.plant.kind)
    return open_plant(model)


def _require_effects(plant: Plant, model: ModelSpec, vehicle: VehicleSpec, file: str) -> None:
    """Make the model's [[effects]] one after the other, and the plant with those on the body."""
    from tunefree_hil.gap.model.graph import is_inert_port

    change = BodyChange()
    for i, spec in enumerate(model.effects):
        port, made = _make_effect(spec, i, vehicle, file)
        if isinstance(made, Block) or is_inert_port(model, port):
            continue
        try:
            change = made(change)
            plant.make(model.plant.params, change)
        except InputError as error:  # it names the effect, but not its place in the file
            error.key = f"effects[{i}]"
            raise


def _make_effect(spec: EffectSpec, i: int, vehicle: VehicleSpec, file: str) -> tuple[Port, Any]:
    """Make effect number i of a file. Returns: its port, and the Block or change of the body."""
    from tunefree_hil.bench.vehicle import effects_of
    from tunefree_hil.config.find import nearest

    key = f"effects[{i}]"
    try:
        ((port, made),) = effects_of([spec], vehicle.nominal.rest_pedal_frac, file)
    except InputError as error:
        error.key = error.key.replace("effects[0]", key, 1)  # it was made as a list of one
        if error.code == UNKNOWN_PART:
            error.key = f"{key}.name"
            if ":" not in spec.name:
                hint = f"{nearest(spec.name, names(EFFECTS))} or 'path/to/file.py:EFFECT' for a user effect"
                raise InputError(
                    f"there is no effect {spec.name!r}", code=error.code, file=file, key=error.key, hint=hint
                ) from error
        raise
    return port, made


def _require_card(model: ModelSpec) -> None:
    """Read every entry of the card that is read later."""
    from tunefree_hil.gap.estimation.nuisance import read_constant_correlations, read_constant_sigmas, read_drift_share
    from tunefree_hil.gap.model.card import read_holdout_errors
    from tunefree_hil.gap.selection.baseline_misfit import baseline_of_model

    for read in (
        read_constant_sigmas,
        read_constant_correlations,
        read_drift_share,
        read_holdout_errors,
        baseline_of_model,
    ):
        read(model)
