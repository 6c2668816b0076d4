"""The repaired model: a model folder with the effects that were found and the updates of recalibration.

Effects go into [[effects]] with interval and provenance. What recalibration moved goes into the model's own numbers
where these mean the same, and into [[effects]] where they do not. What is of the day (slope, wind, grip, a sensor's
bias or scale: UNWRITTEN_EFFECTS) and the clocks are written nowhere, as the next drive has its own. The grip that the
calibration logs had is an exception (`apply_own_numbers`): it stands for the form of the tyres, which is the car's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import (
    ActuatorSpec,
    EffectSpec,
    Interval,
    ModelSpec,
    Number,
    Spec,
    VehicleSpec,
    value_of,
)
from tunefree_hil.gap.estimation.calibration_priors import read_calibration_prior
from tunefree_hil.gap.estimation.nuisance import BRAKE_RISE, RECALIBRATED, UNWRITTEN_EFFECTS
from tunefree_hil.gap.model.card import CALIBRATION_PRIORS_KEY, load_model_card
from tunefree_hil.gap.model.graph import (
    ACCEL,
    LINKAGE_BEND_KEY,
    LINKAGE_BEND_PARAM,
    PEDALS,
    is_acceleration_controlled,
    load_catalogue,
    scale_plant_params,
)
from tunefree_hil.gap.result import SearchResult
from tunefree_hil.gap.selection.baseline_misfit import BASELINE_KEY, UNEXPLAINED_KEY
from tunefree_hil.learn.evaluation.free_run import open_plant
from tunefree_hil.learn.model_folder import CALIBRATION_EFFECTS, CARD_FILE, model_toml_from_spec, write_model_copy
from tunefree_hil.plant.actuation.acceleration_interface import FULL_MPS2
from tunefree_hil.plant.constants import LEAST

ADDITIVE_FIELDS = ("dead_time_s", "offset")  # of a channel, that recalibration adds to; it multiplies the others
MIN_CHANGE = 1e-9  # share of a number below which it is the same
CONSTANT_BY_GAIN = {  # effects that scale a constant of the single-track model
    "brake_gain": "brake_force_n_per_frac",
    "front_stiffness": "front_stiffness_n_per_rad",
    "rear_stiffness": "rear_stiffness_n_per_rad",
}
SEED = 1  # of the bootstrap (gap/estimation/evidence.py)
FILE_HEAD = "# Written by tunefree_hil gap from {model}; {card} lists the logs.\n"

Params = dict[str, float]
S = TypeVar("S", bound=Spec)


class Change(NamedTuple):
    """A number of the model that changed. key: as in model.toml; before, after: None where there is none."""

    key: str
    before: float | None
    after: float | None


class RepairedModel(NamedTuple):
    """model: as it is written. day_effects: UNWRITTEN_EFFECTS, which are not. changes: against the model before."""

    model: ModelSpec
    day_effects: tuple[EffectSpec, ...]
    changes: tuple[Change, ...]


def repair_model(
    model: ModelSpec, vehicle: VehicleSpec, values: Mapping[str, float], effects: Sequence[EffectSpec] = ()
) -> RepairedModel:
    """Move a model to the values of a fit, and add effects.

    Args:
        values: keys as gap/model/graph.py takes them.
        effects: that were found.
    """
    names = {effect.name for effect in effects}
    moved = _moved_effects(values, names)
    day_effects = tuple(EffectSpec(name=name, params=moved.pop(name)) for name in UNWRITTEN_EFFECTS if name in moved)
    plant = open_plant(model)
    base = {**plant.defaults, **model.plant.params}
    params = scale_plant_params(model.plant.params, plant.defaults, values)
    if LINKAGE_BEND_PARAM in params:
        params[LINKAGE_BEND_PARAM] += values.get(LINKAGE_BEND_KEY, 0.0)
    if model.plant.kind == "physics":
        _fold_into_constants(params, moved, vehicle.nominal.rest_pedal_frac, names)
    written = {key: value for key, value in params.items() if key in model.plant.params or _differs(base[key], value)}
    channel_values = merge_pedal_moves(model, values)
    channels = {name: _move_channel(name, spec, channel_values) for name, spec in model.actuators.items()}
    updates = [EffectSpec(name=name, params=effect, provenance=RECALIBRATED) for name, effect in moved.items()]
    added = sorted([*effects, *updates], key=lambda effect: effect.name)  # the order of the graph's series
    repaired = _replace_fields(
        model,
        plant=_replace_fields(model.plant, params=written),
        actuators=channels,
        effects=[*model.effects, *added],
    )
    return RepairedModel(repaired, day_effects, list_changes(model, repaired))


def apply_own_numbers(model: ModelSpec, vehicle: VehicleSpec) -> ModelSpec:
    """A model with the numbers that its calibration logs give.

    Raises:
        InputError: the model's card cannot be read.
    """
    prior, catalogue = read_calibration_prior(model), load_catalogue()
    if not prior.keys:
        return model
    values = {}
    for key, offset in zip(prior.keys, prior.offset.tolist(), strict=True):
        name, _, parameter = key.partition(".")
        values[key] = offset + (catalogue[name].neutral[parameter] if name in catalogue else 0.0)
    made = repair_model(model, vehicle, values)
    day_effects = [_replace_fields(effect, provenance=RECALIBRATED) for effect in made.day_effects]
    return _replace_fields(made.model, effects=[*made.model.effects, *day_effects])


def effect_specs(result: SearchResult, log_hash: str, version: str) -> list[EffectSpec]:
    """The effects that were found, with interval and provenance."""
    provenance = {"log": log_hash, "seed": SEED, "version": version}
    return [
        EffectSpec(
            name=effect["name"],
            params={key: estimate["value"] for key, estimate in effect["params"].items()},
            interval={key: _interval(estimate) for key, estimate in effect["params"].items() if _interval(estimate)},
            provenance=provenance,
        )
        for effect in result.answer["effects"]
    ]


def write_repaired_model(folder: Path, model: ModelSpec, repaired: ModelSpec, story: Mapping[str, Any]) -> ModelSpec:
    """Write the repaired model's folder in one piece, with the other files of the model's folder, and load it.

    Args:
        story: `repair` of card.json. What the old model missed of its calibration logs is left out of the card.

    Raises:
        InputError: the folder exists.
    """
    data = model_toml_from_spec(repaired)
    data["plant"]["card"] = CARD_FILE
    head = FILE_HEAD.format(model=Path(model.folder).name, card=CARD_FILE)
    outdated = (BASELINE_KEY, CALIBRATION_EFFECTS, UNEXPLAINED_KEY, CALIBRATION_PRIORS_KEY)
    card = {key: entry for key, entry in load_model_card(model).items() if key not in outdated}
    write_model_copy(folder, model, head, data, card | {"repair": story})
    return load_model(folder)


def _interval(estimate: Mapping[str, Any]) -> list[float]:
    low, high = estimate["low"], estimate["high"]
    return [low, high] if low is not None and high is not None else []


def _moved_effects(values: Mapping[str, float], effect_names: set[str]) -> dict[str, Params]:
    """Parameters of catalogue effects that recalibration moved, by effect; without the effects that were found."""
    catalogue, moved = load_catalogue(), {}
    for key, value in values.items():
        name, _, parameter = key.partition(".")
        if name in catalogue and name not in effect_names and value != catalogue[name].neutral[parameter]:
            moved.setdefault(name, {})[parameter] = value
    return moved


def _fold_into_constants(params: Params, moved: dict[str, Params], rest: float, effect_names: set[str]) -> None:
    """Move effects that mean the same as a constant of the single-track model from `moved` into `params`."""
    if "throttle_gain" in moved:  # g (duty - rest): zero and full of the pedal lie elsewhere
        gain = moved.pop("throttle_gain")["gain_frac"]
        for key in ("throttle_zero_frac", "throttle_full_frac"):
            params[key] = rest + (params[key] - rest) / gain
    if "brake_gain" in moved and BRAKE_RISE in params:  # the gain is of the duty, which enters this constant twice
        params[BRAKE_RISE] = max(params[BRAKE_RISE] * moved["brake_gain"]["gain_frac"], LEAST[BRAKE_RISE])
    for name, key in CONSTANT_BY_GAIN.items():
        if name in moved:
            params[key] *= moved.pop(name)["gain_frac"]
    if "rolling_resistance" in moved:
        params["rolling_frac"] *= 1.0 + moved.pop("rolling_resistance")["extra_frac"]
    if "aero_drag" in moved:
        params["drag_area_m2"] += moved.pop("aero_drag")["drag_area_m2"]
    if "steer_gain" in moved and "steer_offset" not in effect_names:  # an offset is added after the gain
        gain = moved.pop("steer_gain")["gain_frac"]
        params["steer_ratio"] /= gain
        if "steer_offset" in moved:
            moved["steer_offset"]["offset_rad"] /= gain


def merge_pedal_moves(model: ModelSpec, values: Mapping[str, float]) -> Mapping[str, float]:
    """Values with the moves of the two pedals merged into the channel of an acceleration-controlled vehicle.

    A pedal's offset is an acceleration of that share of FULL_MPS2. Times and gains are the mean of both pedals; a pedal
    that was not moved counts too, as its commands were in the logs.
    """
    if not is_acceleration_controlled(model):
        return values
    merged = {
        key: value for key, value in values.items() if not key.startswith(tuple(f"actuator.{p}." for p in PEDALS))
    }
    for field in ActuatorSpec.__struct_fields__:
        throttle, brake = (values.get(f"actuator.{pedal}.{field}", 0.0) for pedal in PEDALS)
        move = FULL_MPS2 * (throttle - brake) if field == "offset" else 0.5 * (throttle + brake)
        if move:
            merged[f"actuator.{ACCEL}.{field}"] = move
    return merged


def _move_channel(name: str, spec: ActuatorSpec, values: Mapping[str, float]) -> ActuatorSpec:
    """Move a channel's numbers, and their intervals with them."""
    moved: dict[str, Number] = {}
    for field in spec.__struct_fields__:
        amount = values.get(f"actuator.{name}.{field}", 0.0)
        if amount:
            moved[field] = _move_number(getattr(spec, field), amount, field)
    return _replace_fields(spec, **moved)


def _move_number(number: Number, amount: float, field: str) -> Number:
    def move(value: float) -> float:
        if field not in ADDITIVE_FIELDS:
            return value * math.exp(amount)
        return max(value + amount, 0.0) if field == "dead_time_s" else value + amount

    if isinstance(number, Interval):
        return Interval(value=move(number.value), low=move(number.low), high=move(number.high))
    return move(number)


def list_changes(model: ModelSpec, repaired: ModelSpec) -> tuple[Change, ...]:
    """The numbers in which a repaired model differs, effects last."""
    base, changes = {**open_plant(model).defaults, **model.plant.params}, list[Change]()
    for key, after in repaired.plant.params.items():
        if _differs(base[key], after):
            changes.append(Change(f"plant.params.{key}", base[key], after))
    for name, spec in repaired.actuators.items():
        for field in spec.__struct_fields__:
            before, after = value_of(getattr(model.actuators[name], field)), value_of(getattr(spec, field))
            if _differs(before, after):
                changes.append(Change(f"actuators.{name}.{field}", before, after))
    for effect in repaired.effects[len(model.effects) :]:
        changes += [Change(f"effects.{effect.name}.{key}", None, value) for key, value in effect.params.items()]
    return tuple(changes)


def _differs(before: float, after: float) -> bool:
    return abs(after - before) > MIN_CHANGE * max(abs(before), abs(after)) if math.isfinite(before) else False


def _replace_fields(spec: S, **changes: Any) -> S:
    """A spec with other values in some fields."""
    fields = {name: getattr(spec, name) for name in spec.__struct_fields__}
    return type(spec)(**{**fields, **changes})
