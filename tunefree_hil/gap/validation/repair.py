"""A model with what it lacked: effects that were found, and what recalibration moved, as an ordinary model folder.

What was found goes into [[effects]] with interval and provenance. What recalibration moved goes into the model's own
numbers where they mean the same, into [[effects]] where they do not. What is of one day only (slope, wind, grip, a
sensor's bias or scale: drifts.UNWRITTEN) and how well frames are stamped is written nowhere: the next drive has its
own. The grip is an exception as far as the model's own logs had it (`moved`): so much stands for the form of its tyres,
which is the car's.
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
from tunefree_hil.gap.estimation.calibration_priors import own_numbers_of
from tunefree_hil.gap.estimation.nuisance import RECALIBRATED, RISE, UNWRITTEN
from tunefree_hil.gap.model.card import OWN_NUMBERS, card_of
from tunefree_hil.gap.model.graph import ACCEL, BEND, LINKAGE, PEDALS, effects, is_by_accel, scaled
from tunefree_hil.gap.result import Kept
from tunefree_hil.gap.selection.baseline_misfit import KEY, OWN_MISSED
from tunefree_hil.learn.evaluation.free_run import plant_of
from tunefree_hil.learn.model_folder import CARD_FILE, OWN_EFFECTS, data_of, write_beside
from tunefree_hil.plant.actuation.acceleration_interface import FULL_MPS2
from tunefree_hil.plant.constants import LEAST

ADDED = ("dead_time_s", "offset")  # numbers of a channel that recalibration adds to; the others it multiplies
LEAST_CHANGE = 1e-9  # of a number: less is none
GAINS = {  # effects that are a factor on a constant of the single track
    "brake_gain": "brake_force_n_per_frac",
    "front_stiffness": "front_stiffness_n_per_rad",
    "rear_stiffness": "rear_stiffness_n_per_rad",
}
SEED = 1  # of the draws behind intervals (gap/estimation/evidence.py)
HEAD = "# Written by tunefree_hil gap out of {model}; {card} says from which logs.\n"

Params = dict[str, float]
S = TypeVar("S", bound=Spec)


class Change(NamedTuple):
    """A number of the model that is another now. key: as in model.toml; before, after: None where there is none."""

    key: str
    before: float | None
    after: float | None


class Repaired(NamedTuple):
    """model: what is to be written. day: effects of the day, which are not. changes: against the model before."""

    model: ModelSpec
    day: tuple[EffectSpec, ...]
    changes: tuple[Change, ...]


def repaired(
    model: ModelSpec, vehicle: VehicleSpec, values: Mapping[str, float], found: Sequence[EffectSpec] = ()
) -> Repaired:
    """A model moved to `values` (keys as gap/model/graph.py takes them), with the effects `found` in it."""
    names = {one.name for one in found}
    moved = _by_effect(values, names)
    day = tuple(EffectSpec(name=name, params=moved.pop(name)) for name in UNWRITTEN if name in moved)
    plant = plant_of(model)
    base = {**plant.defaults, **model.plant.params}
    params = scaled(model.plant.params, plant.defaults, values)
    if BEND in params:
        params[BEND] += values.get(LINKAGE, 0.0)
    if model.plant.kind == "physics":
        _fold(params, moved, vehicle.nominal.rest_pedal_frac, names)
    own = {key: value for key, value in params.items() if key in model.plant.params or _differs(base[key], value)}
    moves = by_channel(model, values)
    channels = {name: _channel(name, spec, moves) for name, spec in model.actuators.items()}
    more = [EffectSpec(name=name, params=one, provenance=RECALIBRATED) for name, one in moved.items()]
    behind = sorted([*found, *more], key=lambda one: one.name)  # as the graph has them in series
    made = _with(model, plant=_with(model.plant, params=own), actuators=channels, effects=[*model.effects, *behind])
    return Repaired(made, day, changes_of(model, made))


def moved(model: ModelSpec, vehicle: VehicleSpec) -> ModelSpec:
    """A model with the numbers that its own logs say. Raises InputError for a card that is none."""
    own, known = own_numbers_of(model), effects()
    if not own.keys:
        return model
    values = {}
    for key, off in zip(own.keys, own.off.tolist(), strict=True):
        name, _, parameter = key.partition(".")
        values[key] = off + (known[name].neutral[parameter] if name in known else 0.0)
    made = repaired(model, vehicle, values)
    throughout = [_with(one, provenance=RECALIBRATED) for one in made.day]
    return _with(made.model, effects=[*made.model.effects, *throughout])


def found_effects(kept: Kept, log_hash: str, version: str) -> list[EffectSpec]:
    """What was found, with interval and provenance."""
    provenance = {"log": log_hash, "seed": SEED, "version": version}
    return [
        EffectSpec(
            name=one["name"],
            params={key: value["value"] for key, value in one["params"].items()},
            interval={key: _ends(value) for key, value in one["params"].items() if _ends(value)},
            provenance=provenance,
        )
        for one in kept.answer["effects"]
    ]


def write_repaired(folder: Path, model: ModelSpec, made: ModelSpec, story: Mapping[str, Any]) -> ModelSpec:
    """Write the folder whole or not at all, beside what else the model's folder holds; the model as it is loaded.

    story: what card.json says of the repair. What the old model missed of its own logs is not this one's any more.
    Raises InputError for a folder that is there already.
    """
    data = data_of(made)
    data["plant"]["card"] = CARD_FILE
    head = HEAD.format(model=Path(model.folder).name, card=CARD_FILE)
    card = {key: said for key, said in card_of(model).items() if key not in (KEY, OWN_EFFECTS, OWN_MISSED, OWN_NUMBERS)}
    write_beside(folder, model, head, data, card | {"repair": story})
    return load_model(folder)


def _ends(value: Mapping[str, Any]) -> list[float]:
    return [value["low"], value["high"]] if value["low"] is not None and value["high"] is not None else []


def _by_effect(values: Mapping[str, float], found: set[str]) -> dict[str, Params]:
    """Parameters of effects of the catalogue that recalibration moved, by effect."""
    known, moved = effects(), {}
    for key, value in values.items():
        name, _, parameter = key.partition(".")
        if name in known and name not in found and value != known[name].neutral[parameter]:
            moved.setdefault(name, {})[parameter] = value
    return moved


def _fold(params: Params, moved: dict[str, Params], rest: float, found: set[str]) -> None:
    """Put into the single track's constants what means the same there; takes it out of `moved`."""
    if "throttle_gain" in moved:  # g (duty - rest) is a pedal whose zero and full lie at another place
        gain = moved.pop("throttle_gain")["gain_frac"]
        for key in ("throttle_zero_frac", "throttle_full_frac"):
            params[key] = rest + (params[key] - rest) / gain
    if "brake_gain" in moved and RISE in params:  # it is of the duty, which counts twice there
        params[RISE] = max(params[RISE] * moved["brake_gain"]["gain_frac"], LEAST[RISE])
    for name, key in GAINS.items():
        if name in moved:
            params[key] *= moved.pop(name)["gain_frac"]
    if "rolling_resistance" in moved:
        params["rolling_frac"] *= 1.0 + moved.pop("rolling_resistance")["extra_frac"]
    if "aero_drag" in moved:
        params["drag_area_m2"] += moved.pop("aero_drag")["drag_area_m2"]
    if "steer_gain" in moved and "steer_offset" not in found:  # an offset is behind the gain, and has its value there
        gain = moved.pop("steer_gain")["gain_frac"]
        params["steer_ratio"] /= gain
        if "steer_offset" in moved:
            moved["steer_offset"]["offset_rad"] /= gain


def by_channel(model: ModelSpec, values: Mapping[str, float]) -> Mapping[str, float]:
    """`values` with what a search moved of the two pedals of a car that is asked for an acceleration as its channel's.

    What a pedal adds or takes is an acceleration of that share of FULL_MPS2; times and gains are one for both, and so
    the mean of what was moved of either. A pedal that was not moved counts: its commands were in the logs, too.
    """
    if not is_by_accel(model):
        return values
    found = {key: value for key, value in values.items() if not key.startswith(tuple(f"actuator.{p}." for p in PEDALS))}
    for field in ActuatorSpec.__struct_fields__:
        throttle, brake = (values.get(f"actuator.{pedal}.{field}", 0.0) for pedal in PEDALS)
        by = FULL_MPS2 * (throttle - brake) if field == "offset" else 0.5 * (throttle + brake)
        if by:
            found[f"actuator.{ACCEL}.{field}"] = by
    return found


def _channel(name: str, spec: ActuatorSpec, values: Mapping[str, float]) -> ActuatorSpec:
    """A channel's numbers moved, each with an interval as wide as it was."""
    moved: dict[str, Number] = {}
    for field in spec.__struct_fields__:
        by = values.get(f"actuator.{name}.{field}", 0.0)
        if by:
            moved[field] = _moved(getattr(spec, field), by, field)
    return _with(spec, **moved)


def _moved(number: Number, by: float, field: str) -> Number:
    def move(value: float) -> float:
        if field not in ADDED:
            return value * math.exp(by)
        return max(value + by, 0.0) if field == "dead_time_s" else value + by

    if isinstance(number, Interval):
        return Interval(value=move(number.value), low=move(number.low), high=move(number.high))
    return move(number)


def changes_of(model: ModelSpec, made: ModelSpec) -> tuple[Change, ...]:
    """What is another number in a model that was made of another, effects last."""
    base, found = {**plant_of(model).defaults, **model.plant.params}, []
    for key, after in made.plant.params.items():
        if _differs(base[key], after):
            found.append(Change(f"plant.params.{key}", base[key], after))
    for name, spec in made.actuators.items():
        for field in spec.__struct_fields__:
            before, after = value_of(getattr(model.actuators[name], field)), value_of(getattr(spec, field))
            if _differs(before, after):
                found.append(Change(f"actuators.{name}.{field}", before, after))
    for one in made.effects[len(model.effects) :]:
        found += [Change(f"effects.{one.name}.{key}", None, value) for key, value in one.params.items()]
    return tuple(found)


def _differs(before: float, after: float) -> bool:
    return abs(after - before) > LEAST_CHANGE * max(abs(before), abs(after)) if math.isfinite(before) else False


def _with(spec: S, **changes: Any) -> S:
    """The same spec with other values in some fields."""
    fields = {name: getattr(spec, name) for name in spec.__struct_fields__}
    return type(spec)(**{**fields, **changes})
