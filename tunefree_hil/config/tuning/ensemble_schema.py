"""The table [ensemble] of a bench file: the cars that every candidate of a search drives."""

from __future__ import annotations

from typing import Literal

from msgspec import field

from tunefree_hil.config.problem import ConfigProblem, Problems
from tunefree_hil.config.tuning.car_limit import MOST_CARS
from tunefree_hil.config.vehicle_schema import Spec

FACTORS = ("dead_time", "lag", "mass", "friction", "steer_gain")
FACTOR_BOUNDS = (0.2, 5.0)  # a factor beyond it makes another vehicle, not the same one a little different
MOST_PERCENT = 100.0


class EnsembleSpec(Spec, frozen=True, kw_only=True):
    """Factors are [low, high] on the model's own number, 1 within; [1, 1]: it does not vary.

    judge: mean: mean score over all drives. tail: mean of that and of the worst `tail` percent of the drives.
    constraint: score of the model as it is; the other cars must keep the requirements.
    """

    cars: int = 5  # the model as it is, and others
    judge: Literal["mean", "tail", "constraint"] = "tail"
    tail: float = 20.0
    model_intervals: bool = True
    dead_time: list[float] = field(default_factory=lambda: [0.8, 1.2])  # within +/-20 % nothing may fail: margins.md
    lag: list[float] = field(default_factory=lambda: [0.8, 1.2])
    mass: list[float] = field(default_factory=lambda: [0.9, 1.2])  # an empty tank to four passengers with luggage
    friction: list[float] = field(default_factory=lambda: [0.8, 1.0])  # a wet road
    steer_gain: list[float] = field(default_factory=lambda: [0.9, 1.1])  # tyres and load change the understeer
    racing: int = 2  # roads after which a bad candidate is dropped; 0: all are driven to the end
    select_roads: str = "families:10"
    select_model: str = ""


ENSEMBLE_WORDS: dict[str, str] = {
    "cars": "number of cars: the model as it is, and others that are drawn by the seed",
    "judge": "mean: of all drives; tail: half of it by the worst drives; constraint: all cars keep the requirements",
    "tail": "percent of the drives that are the worst ones",
    "model_intervals": "whether the intervals of the model's actuators and effects count too",
    "dead_time": "[low, high] factor on the dead times of all actuators",
    "lag": "[low, high] factor on their lags",
    "mass": "[low, high] factor on the mass",
    "friction": "[low, high] factor on the friction between tyre and road",
    "steer_gain": "[low, high] factor on the road-wheel angle after the report",
    "racing": "roads after which a candidate that fails or is far beyond the requirements is dropped; 0: none is",
    "select_roads": "set of roads that chooses among near-equal trials, such as families:10; '' for no choice",
    "select_model": "second plant for that choice; '' for the model with cars of another seed",
}


def check_ensemble(spec: EnsembleSpec) -> Problems:
    """Counts, and factors around 1."""
    if not 2 <= spec.cars <= MOST_CARS:
        yield ConfigProblem("ensemble.cars", f"{spec.cars} does not fit", f"give 2 to {MOST_CARS}, or no [ensemble]")
    if not 0.0 < spec.tail <= MOST_PERCENT:
        yield ConfigProblem("ensemble.tail", f"{spec.tail:g} is no share of the drives", "give percent, such as 20")
    if spec.racing < 0:
        yield ConfigProblem("ensemble.racing", f"{spec.racing} is below 0", "give a number of roads, or 0")
    low_bound, high_bound = FACTOR_BOUNDS
    for name in FACTORS:
        factors: list[float] = getattr(spec, name)
        if len(factors) != 2 or not low_bound <= factors[0] <= 1.0 <= factors[1] <= high_bound:
            hint = f"give [low, high] from {low_bound:g} to {high_bound:g} with 1 between them"
            yield ConfigProblem(f"ensemble.{name}", f"{factors} are no factors around the model", hint)
