"""A model with faster or slower actuators than in its folder.

Effects can only add to a delay; a factor below 1 changes the model's own numbers. Another factor needs no compilation.
Single numbers of the model have names too: 'steer.gain' of [actuators.steer], 'brake_fade.gain_frac' of an effect.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench.vehicle import load_plant
from tunefree_hil.config.schema import ActuatorSpec, Interval, ModelSpec, Number, Spec, value_of

DEAD_TIME, LAG = "dead_time", "lag"
SCALES = (DEAD_TIME, LAG)
ACTUATOR_NUMBERS = ("dead_time_s", "lag_s", "natural_hz", "damping", "rate_limit", "dead_band", "gain", "offset")

S = TypeVar("S", bound=Spec)


def scaled(model: ModelSpec, scale: Mapping[str, float]) -> ModelSpec:
    """The model with the dead times and lags of all its actuators times scale["dead_time"] and scale["lag"].

    Names with a dot are single numbers of the model, which have any finite factor.

    Raises InputError for another name, a factor that is not above 0, or a plant that does not name its
    parameters for these times.
    """
    numbers = {name: factor for name, factor in scale.items() if "." in name}
    scale = {name: factor for name, factor in scale.items() if name not in numbers}
    if numbers:
        model = _with_scaled_numbers(model, numbers)
    for name, factor in scale.items():
        if name not in SCALES or not (math.isfinite(factor) and factor > 0.0):
            raise InputError(
                f"{name} = {factor} scales nothing",
                code="bad_scale",
                key=name,
                hint=f"a factor above 0 for {' or '.join(SCALES)}",
            )
    if not scale:
        return model
    times = own_times(model)
    if times is None:
        late, lag = scale.get(DEAD_TIME, 1.0), scale.get(LAG, 1.0)
        return _with(model, actuators={name: _actuator(one, late, lag) for name, one in model.actuators.items()})
    params = {**load_plant(model.plant.kind).defaults, **model.plant.params}
    params |= {key: factor * params[key] for name, factor in scale.items() for key in times[name]}
    return _with(model, plant=_with(model.plant, params=params))


def own_times(model: ModelSpec) -> dict[str, tuple[str, ...]] | None:
    """Parameters of a plant with actuators of its own that are dead times and lags; None where [actuators] is used.

    Raises InputError where the plant does not name them.
    """
    plant = load_plant(model.plant.kind)
    if plant.actuators is None:
        return None
    times = {DEAD_TIME: plant.dead_times, LAG: plant.lags}
    silent = [name for name, keys in times.items() if not keys]
    if silent:
        raise InputError(
            f"plant {model.plant.kind!r} does not say which of its parameters are its {' and '.join(silent)}",
            code="unknown_times",
            file=f"{model.folder}/model.toml",
            key="plant.kind",
            hint="PLANT.dead_times and PLANT.lags name them",
        )
    return times


def mass_of(model: ModelSpec) -> float:
    """The unladen mass [kg] of the model's plant. Raises InputError where it has none."""
    mass_kg = {**load_plant(model.plant.kind).defaults, **model.plant.params}.get("mass_kg")
    if mass_kg is None:
        raise InputError(
            f"plant {model.plant.kind!r} has no parameter mass_kg",
            code="unknown_mass",
            file=f"{model.folder}/model.toml",
            key="plant.params.mass_kg",
            hint="a plant whose mass may be changed has it in PLANT.defaults",
        )
    return mass_kg


def model_numbers(model: ModelSpec) -> dict[str, Number]:
    """Numbers of the model that a factor can change, by name: of its actuators and its effects, with intervals."""
    numbers: dict[str, Number] = {}
    for channel, actuator in model.actuators.items():
        numbers |= {f"{channel}.{name}": getattr(actuator, name) for name in ACTUATOR_NUMBERS}
    for effect in model.effects:
        for name, value in effect.params.items():
            span = effect.interval.get(name)
            known = Interval(value=value, low=span[0], high=span[1]) if span else value
            numbers[f"{effect.name}.{name}"] = known
    return numbers


def _with_scaled_numbers(model: ModelSpec, factors: Mapping[str, float]) -> ModelSpec:
    known = model_numbers(model)
    for name, factor in factors.items():
        if name not in known or not math.isfinite(factor):
            raise InputError(
                f"{name} = {factor} scales nothing",
                code="bad_scale",
                key=name,
                hint=f"a finite factor for {', '.join(known) or 'nothing: the model has no such numbers'}",
            )
    values = {name: value_of(known[name]) * factor for name, factor in factors.items()}

    def changed(owner: str, names: Iterable[str]) -> dict[str, float]:
        return {name: values[f"{owner}.{name}"] for name in names if f"{owner}.{name}" in values}

    actuators = {
        channel: _with(actuator, **changed(channel, ACTUATOR_NUMBERS)) for channel, actuator in model.actuators.items()
    }
    effects = [
        _with(effect, params={**effect.params, **changed(effect.name, effect.params)}) for effect in model.effects
    ]
    return _with(model, actuators=actuators, effects=effects)


def _actuator(spec: ActuatorSpec, late: float, lag: float) -> ActuatorSpec:
    """A channel; the lag of order 2 is in its natural frequency."""
    return _with(
        spec,
        dead_time_s=late * value_of(spec.dead_time_s),
        lag_s=lag * value_of(spec.lag_s),
        natural_hz=value_of(spec.natural_hz) / lag,
    )


def _with(spec: S, **changes: Any) -> S:
    """The same spec with other values in some fields."""
    fields = {name: getattr(spec, name) for name in spec.__struct_fields__}
    return type(spec)(**{**fields, **changes})
