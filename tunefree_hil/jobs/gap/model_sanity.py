"""Whether a model can be a car at all: its plant, its effects and its card are made once before a log is read.

Whoever looks for what a model lacks makes them again deep inside, where nobody knows any more which key was wrong.
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
NO_SUCH_EFFECT = "unknown_part"  # base/parts.py


def require_sound(model: ModelSpec, vehicle: VehicleSpec) -> None:
    """Raises InputError that names model.toml (or the card) and the key of what makes no car."""
    file = f"{model.folder}/model.toml"
    try:
        plant = _plant_of(model)
        require_constants(model.plant.kind, plant.defaults, model.plant.params)
        plant.make(model.plant.params, BodyChange())
        _require_effects(plant, model, vehicle, file)
    except InputError as error:
        error.file = error.file or file
        raise
    _require_card(model)


def _plant_of(model: ModelSpec) -> Plant:
    """The plant, of a kind that can be told a measured motion; of the others a bench knows the names."""
    from tunefree_hil.bench.vehicle import load_plant
    from tunefree_hil.learn.evaluation.free_run import plant_of

    load_plant(model.plant.kind)
    return plant_of(model)


def _require_effects(plant: Plant, model: ModelSpec, vehicle: VehicleSpec, file: str) -> None:
    """The model's own [[effects]], one after the other; those on the body on its plant."""
    from tunefree_hil.gap.model.graph import is_unheard

    change = BodyChange()
    for i, spec in enumerate(model.effects):
        port, made = _made(spec, i, vehicle, file)
        if isinstance(made, Block) or is_unheard(model, port):
            continue
        try:
            change = made(change)
            plant.make(model.plant.params, change)
        except InputError as error:  # it knows the effect, and not that it stands in this file
            error.key = f"effects[{i}]"
            raise


def _made(spec: EffectSpec, i: int, vehicle: VehicleSpec, file: str) -> tuple[Port, Any]:
    """Effect number i of a file: its port and what it makes."""
    from tunefree_hil.bench.vehicle import effects_of
    from tunefree_hil.config.find import nearest

    key = f"effects[{i}]"
    try:
        ((port, made),) = effects_of([spec], vehicle.nominal.rest_pedal_frac, file)
    except InputError as error:
        error.key = error.key.replace("effects[0]", key, 1)  # it was the only one of its list
        if error.code == NO_SUCH_EFFECT:
            error.key = f"{key}.name"
            if ":" not in spec.name:
                hint = f"{nearest(spec.name, names(EFFECTS))} or 'path/to/file.py:EFFECT' for one of your own"
                raise InputError(
                    f"there is no effect {spec.name!r}", code=error.code, file=file, key=error.key, hint=hint
                ) from error
        raise
    return port, made


def _require_card(model: ModelSpec) -> None:
    """All that is read of a card later."""
    from tunefree_hil.gap.estimation.nuisance import doubts_of, held_of, related_of
    from tunefree_hil.gap.model.card import held_out_of
    from tunefree_hil.gap.selection.baseline_misfit import usual_of

    for read in (doubts_of, related_of, held_of, held_out_of, usual_of):
        read(model)
