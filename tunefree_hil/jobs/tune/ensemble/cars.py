"""The cars of a bench file's [ensemble], as jobs of the batch."""

from __future__ import annotations

import math
from collections.abc import Mapping

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, model_of
from tunefree_hil.bench.batch import Job
from tunefree_hil.bench.scaling import DEAD_TIME, LAG, mass_of, model_numbers, scaled
from tunefree_hil.config.schema import Interval, ModelSpec, ScenarioSpec
from tunefree_hil.config.tuning.ensemble_schema import FACTORS, EnsembleSpec
from tunefree_hil.tune.ensemble import CarRanges, EnsembleCar, FactorRange, draw_cars, noise_seed

EFFECTS_OF = {"mass": "payload", "friction": "friction", "steer_gain": "steer_gain"}  # of the batch, by factor
MIN_INTERVAL_SHARE = 0.01  # of the number: a narrower interval changes no drive


class EnsembleCars:
    """The cars of a bench for one model, and the jobs that drive them. Raises InputError for a model without them.

    effects: Names for Batch(extra_effects=...).
    """

    def __init__(self, bench: Bench, spec: EnsembleSpec, model: str, seed: int, *, count: int = 0) -> None:
        """count: Number of cars; 0 for that of the bench file."""
        self._bench = bench
        plant = model_of(bench, model)
        ranges = car_ranges(spec, plant)
        self.effects = tuple(EFFECTS_OF[name] for name in ranges.variant if name in EFFECTS_OF)
        self._mass_kg = mass_of(plant) if "mass" in ranges.variant else 0.0
        if {DEAD_TIME, LAG} & set(ranges.variant):
            scaled(plant, {DEAD_TIME: 1.1, LAG: 1.1})  # raises where the plant does not name its times
        self.cars = draw_cars(ranges, count or spec.cars, seed)

    def job(self, values: Mapping[str, float], scenario: ScenarioSpec, car: EnsembleCar) -> Job:
        """One drive of a candidate with a car."""
        variant = car.variant
        effects: dict[str, dict[str, float]] = {}
        if variant.mass != 1.0:
            effects["payload"] = {"mass_kg": (variant.mass - 1.0) * self._mass_kg}
        if variant.friction != 1.0:
            effects["friction"] = {"friction_frac": variant.friction}
        if variant.steer_gain != 1.0:
            effects["steer_gain"] = {"gain_frac": variant.steer_gain}
        times = {DEAD_TIME: variant.dead_time, LAG: variant.lag}
        scale = {**car.numbers, **{name: factor for name, factor in times.items() if factor != 1.0}}
        seed = None if car.number == 0 else noise_seed(scenario.noise_seed, car)
        return Job(values, scenario, seed, effects=effects, scale=scale)


def car_ranges(spec: EnsembleSpec, model: ModelSpec) -> CarRanges:
    """The ranges of the bench file, and the intervals that the model states.

    Raises:
        InputError: Nothing varies.
    """
    factors = {name: FactorRange(*getattr(spec, name)) for name in FACTORS}
    variant = {name: span for name, span in factors.items() if span.low < span.high}
    numbers = _interval_factors(model) if spec.model_intervals else {}
    if not variant and not numbers:
        message = "no number of the cars varies: they would all be the same"
        raise InputError(message, code="bad_ensemble", key="ensemble", hint="give a range, such as mass = [0.9, 1.2]")
    return CarRanges(variant, numbers)


def _interval_factors(model: ModelSpec) -> dict[str, FactorRange]:
    """The intervals of a model as factors on its numbers; those that are open, narrow, or of a 0 are left out."""
    ranges = {}
    for name, number in model_numbers(model).items():
        if not isinstance(number, Interval) or number.value == 0.0:
            continue
        low, high = sorted((number.low / number.value, number.high / number.value))
        if math.isfinite(low) and math.isfinite(high) and high - low >= MIN_INTERVAL_SHARE:
            ranges[name] = FactorRange(low, high)
    return ranges
