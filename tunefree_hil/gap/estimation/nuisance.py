"""The model that lacks nothing: recalibration alone, within what a calibrated model may be off.

Whatever drifts a little from one day to the next would be called an effect by a search that holds all else fixed. So
every candidate, and the model without any, may move these numbers as far as their priors let it. Most are parameters
of effects of the catalogue near neutral, so that they mean the same on every kind of plant; an effect that is suspected
has its prior let go.

What changes in a car from one day to the next, as parameters of effects of the catalogue: one row says all of it.

A row is a number that recalibration may move (gap/estimation/nuisance.py). Whoever adds one says here by how much, how well a
calibration knows it, whether it belongs to the day or to the car, and where it shows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tunefree_hil.config.schema import ActuatorSpec, Interval, ModelSpec, Number, value_of
from tunefree_hil.gap.model.card import card_of, no_card
from tunefree_hil.gap.model.graph import BEND, CHANNELS, LINKAGE, Graph, channel_spec, is_known
from tunefree_hil.learn.data_sheet import BEND_DOUBT

Array = np.ndarray


class Nuisance(NamedTuple):
    """A number that may be off: key as `Graph.run` takes it, its neutral value, standard deviation in its unit.

    told: of that, what is the same every day (what the model's calibration says of `constant`). drift: what may be of
    the day; the rest, but for the grip, of which that is partly the form that the model has its tyres in (`formed`).
    turned: 1.0, or -1.0 where more of it is less of the constant.
    """

    key: str
    neutral: float
    sigma: float
    told: float = 0.0
    constant: str = ""
    turned: float = 1.0
    drift: float = 0.0


RISE = "brake_rise_per_frac"
# Constants of the plant: standard deviation of the logarithm, or an amount of their own unit (OWN_UNIT)
CONSTANTS: dict[str, float] = {
    "drive_force_n": 0.01,  # the throttle's gain, above, does nearly the same
    "drive_knee_frac": 0.04,
    "creep_speed_mps": 0.05,
    "drive_power_w": 0.02,
    "drive_corner": 0.05,
    "throttle_zero_frac": 0.002,
    "creep_force_n": 0.05,
    "overrun_force_n": 0.05,
    RISE: 0.0,  # a brake pulls as it is built: only what its calibration leaves open
    "yaw_inertia_kgm2": 0.03,
    "front_axle_m": 0.04,  # geometry is the data sheet's, and no calibration moves it
    "wheelbase_m": 0.008,
}
OWN_UNIT = {"throttle_zero_frac", RISE}  # of CONSTANTS: its doubt is an amount, that of all others a share
AMOUNTS = {BEND, RISE}  # of them, what may be nothing: a calibration's deviation is in their own unit
# A model that comes as near to the logs it was made from as EXACT_MPS of speed (of `calibrate`: over its free runs of a
# few seconds; of `learn`: after 10 s, on stretches held out) has taken in what its car is throughout: recalibration may
# move no more than HELD of what changes from day to day, and what has moved further is looked for by name. One that has
# not shown that may move all of it, from EXACT_MPS / HELD on: what it misses there is missed here, too, and is no news.
HELD, EXACT_MPS, FREE_S = 0.25, 0.06, "10"
WIDER = math.sqrt(2.0)  # than a calibration's own deviation: what these drives would make of it is no better known
MOST_DOUBT = 0.15  # of a constant; what was never known is no licence to explain everything
MOST_DRAG = 3.1  # deviations that the drag area must hold: less than nothing is no car
# A calibration's doubt of each of these is that of the others: it knows what they come to together much better. Where
# its card does not say how they hang together, their doubt is no licence to move one of them alone.
SHARED = {
    "drive_force_n", "drive_knee_frac", "drive_corner", "overrun_force_n", "rolling_frac", "drag_area_m2",
    "throttle_zero_frac",
}  # fmt: skip
LEAST_DEAD_TIME_S, LEAST_LAG, LEAST_GAIN = 0.001, 0.01, 0.0005  # no channel is known better than that another day
LEAST_OFFSET = 5e-5  # of a duty, or rad
# How well it is known when a frame's numbers were taken, s: parts of a tick, of a bus's queue
CLOCKS = {"clock.throttle_s": 0.004, "clock.brake_s": 0.004, "clock.steer_s": 0.004, "clock.ins_s": 0.004}
# Of the road wheels' linkage (plant/data_sheet.py), per rad²: what nobody calibrated may be off by, and what a
# calibration's own deviation is never less than
MOST_BEND, LEAST_BEND = 0.5 * BEND_DOUBT, 0.08


def nuisances(graph: Graph, model: ModelSpec, doubts: Mapping[str, float], held: float = 1.0) -> list[Nuisance]:
    """Of a model: those that its plant has. doubts: standard deviations of its constants' logarithms (`doubts_of`);
    held: the share of what changes from day to day that they may move (`held_of`).
    """
    params = {**graph.plant.defaults, **model.plant.params}
    heavy = params.get("mass_kg", ROAD_CAR_KG) / ROAD_CAR_KG
    some = [(one, graph.can[one.effect].neutral[one.parameter]) for one in ROWS if one.effect in graph.can]
    some += [
        (Drift("plant", name, least, "", name, own_unit=name in OWN_UNIT), 0.0)
        for name, least in CONSTANTS.items()
        if params.get(name, 0.0) > 0.0 or name in OWN_UNIT & params.keys()  # of nothing no share is more
    ]
    found = []
    for one, neutral in some:
        constant = one.constant
        least = one.sigma * (heavy if one.by_weight else 1.0) * (1.0 if one.daily else held)
        told = min(WIDER * doubts.get(constant, 0.0), MOST_DOUBT)
        told *= params.get(constant, 0.0) if one.own_unit and constant not in AMOUNTS else 1.0
        # A car that is asked for an acceleration has no drag that anybody sees, and none has less than nothing
        most = params.get(constant, math.inf) / MOST_DRAG if constant == "drag_area_m2" else math.inf
        sigma = min(math.hypot(least, told), most)
        if one.formed:
            told = sigma * math.sqrt(1.0 - held**2)
        if sigma > 0.0:
            turned = -1.0 if one.against else 1.0
            found.append(Nuisance(one.key, neutral, sigma, min(told, sigma), constant, turned, least))
    found += [Nuisance(key, 0.0, sigma) for key, sigma in CLOCKS.items()]
    if BEND in graph.plant.defaults:  # of another plant no model could be written with it
        found.append(_linkage(doubts))
    for channel in CHANNELS:
        found += _of_channel(channel, channel_spec(model, channel) if is_known(model, channel) else None)
    return found


def _linkage(doubts: Mapping[str, float]) -> Nuisance:
    told = WIDER * doubts.get(BEND, MOST_BEND)
    sigma = min(math.hypot(LEAST_BEND, told), MOST_BEND)
    return Nuisance(LINKAGE, 0.0, sigma, min(told, sigma), BEND)


def doubts_of(model: ModelSpec) -> dict[str, float]:
    """Standard deviations of the logarithms of a model's constants (of AMOUNTS their own), from the card of
    `calibrate`; empty without one.
    """
    together = related_of(model)
    try:
        return {
            name: (one["high"] - one["low"] if name in AMOUNTS else math.log(one["high"] / one["low"])) / 3.92
            for name, one in card_of(model).get("constants", {}).items()
            if isinstance(one, dict) and one.get("high", 0.0) > one.get("low", 0.0)
            if one.get("low", 0.0) > 0.0 or name in AMOUNTS
            if name in together or name not in SHARED
        }
    except (AttributeError, TypeError, KeyError) as error:
        raise no_card(Path(model.folder) / model.plant.card, error) from error


def related_of(model: ModelSpec) -> dict[str, dict[str, float]]:
    """How far the doubts of a model's constants go together: correlations by name and name, from the card of
    `calibrate`; empty where it says nothing of that.
    """
    try:
        said = card_of(model).get("constants_together") or {"names": [], "correlation": []}
        rows = zip(said["names"], said["correlation"], strict=True)
        return {name: {other: float(r) for other, r in zip(said["names"], row, strict=True)} for name, row in rows}
    except (AttributeError, TypeError, KeyError, ValueError) as error:
        raise no_card(Path(model.folder) / model.plant.card, error) from error


def held_of(model: ModelSpec, pace: float = 1.0) -> float:
    """Share of what changes from day to day that recalibration may move, by how near a model comes to its own logs.

    pace: of a model car, as a share of a road car's (chain.pace_of). Raises InputError for a card that is none.
    """
    card = card_of(model)
    try:
        if "free_run_rms" in card:
            told = any(one["known"] for one in card["constants"].values())
            missed = card["free_run_rms"]["training"]["fitted"]["speed_mps"] if told else None
        else:
            runs = card.get("free_run", {}).get(card.get("kind"), {})
            missed = max(
                (one[FREE_S]["speed_mps"]["mean"] for one in runs.values() if FREE_S in (one or ())), default=None
            )
        share = math.inf if missed is None else float(missed) / (pace * EXACT_MPS / HELD)
    except (AttributeError, TypeError, KeyError, ValueError) as error:
        raise no_card(Path(model.folder) / model.plant.card, error) from error
    return min(max(share, HELD), 1.0)


def correlation(some: Sequence[Nuisance], related: Mapping[str, Mapping[str, float]]) -> Array:
    """Of all nuisances [p, p]: what a calibration is off by is off together, what is of the day is each one's own."""
    found = np.eye(len(some))
    for i, one in enumerate(some):
        for j, other in enumerate(some[:i]):
            both = one.turned * other.turned * one.told * other.told / (one.sigma * other.sigma)
            found[i, j] = found[j, i] = both * related.get(one.constant, {}).get(other.constant, 0.0)
    return found


def _of_channel(channel: str, spec: ActuatorSpec | None) -> list[Nuisance]:
    """Numbers of [actuators] within their intervals (95 %), but never closer than a channel is known."""
    if spec is None:
        return []
    found = [_added(channel, "dead_time_s", spec.dead_time_s, LEAST_DEAD_TIME_S)]
    found.append(_added(channel, "offset", spec.offset, LEAST_OFFSET))
    names = ("lag_s",) if spec.order == 1 else ("natural_hz", "damping")
    for name in (*names, "gain"):
        number = getattr(spec, name)
        value = value_of(number)
        if value > 0.0:
            sigma = max(_deviation(number) / value, LEAST_GAIN if name == "gain" else LEAST_LAG)
            found.append(Nuisance(f"actuator.{channel}.{name}", 0.0, min(sigma, 0.3)))
    return found


def _added(channel: str, name: str, number: Number, least: float) -> Nuisance:
    sigma = max(_deviation(number), least)
    return Nuisance(f"actuator.{channel}.{name}", 0.0, sigma)


def _deviation(number: Number) -> float:
    """Standard deviation of a number with an interval of 95 %."""
    return (number.high - number.low) / 3.92 if isinstance(number, Interval) else 0.0


class Drift(NamedTuple):
    """sigma: standard deviation from day to day, in the parameter's unit; why: what changes there.

    constant: the constant of the plant (card.json of `calibrate`) by which the doubt about it is known; own_unit: that
    doubt is in the constant's own unit, not a share of it; against: more of it is less of the constant.
    daily: of the day and not of the car: no calibration takes it in, however near it comes. formed: by it recalibration
    makes up for a form that the model has not, too, and that is the same every day. written: into a repaired
    model; what is of the day is not, nor what the next day's sensors or tyres have otherwise. by_weight: sigma is of
    ROAD_CAR_KG, and a tenth of the weight is pushed by a tenth. sideways: it shows in how the car turns and in what it
    feels sideways.
    """

    effect: str
    parameter: str
    sigma: float
    why: str
    constant: str = ""
    own_unit: bool = False
    against: bool = False
    daily: bool = False
    formed: bool = False
    written: bool = True
    by_weight: bool = False
    sideways: bool = False

    @property
    def key(self) -> str:
        """As gap/model/graph.py takes it."""
        return f"{self.effect}.{self.parameter}"


ROAD_CAR_KG = 1800.0
TYRES, GYRO, ACCEL = (
    "tyre pressure, temperature",
    "a gyro's bias from one start to the next",
    "the same of an accelerometer",
)
ROWS = (
    Drift("throttle_gain", "gain_frac", 0.02, "fuel, temperature of the engine"),
    Drift("brake_gain", "gain_frac", 0.02, "temperature of the discs", "brake_force_n_per_frac"),
    Drift("steer_gain", "gain_frac", 0.01, "what a fit leaves of the steering ratio", "steer_ratio", against=True),
    Drift("steer_offset", "offset_rad", 0.003, "straight ahead, as a calibration finds it"),
    Drift("rolling_resistance", "extra_frac", 0.06, TYRES, "rolling_frac"),
    Drift("aero_drag", "drag_area_m2", 0.03, "what a fit leaves of it at town speeds", "drag_area_m2", own_unit=True),
    # The grip is of the day: by it a model has the form of its tyres' curve right, too, which no calibration takes in
    Drift(
        "friction", "friction_frac", 0.15, "nobody measured it",
        daily=True, formed=True, written=False, sideways=True,
    ),
    Drift("front_stiffness", "gain_frac", 0.02, TYRES, "front_stiffness_n_per_rad", sideways=True),
    Drift("rear_stiffness", "gain_frac", 0.02, TYRES, "rear_stiffness_n_per_rad", sideways=True),
    Drift("grade", "grade_rad", 0.0007, "no road is level", daily=True, written=False),
    Drift(
        "side_wind", "force_n", 8.0, "camber of a level road, a breeze",
        daily=True, written=False, by_weight=True, sideways=True,
    ),
    Drift("speed_scale", "scale_frac", 0.001, "rolling radius", written=False),
    Drift("yaw_rate_bias", "bias_radps", 0.0003, GYRO, daily=True, written=False),
    Drift("yaw_rate_scale", "scale_frac", 0.002, "a gyro's scale", written=False),
    Drift("accel_bias", "bias_mps2", 0.008, ACCEL, daily=True, written=False),
)  # fmt: skip
BY_KEY = {one.key: one for one in ROWS}
DRIFT = {one.key: one.sigma for one in ROWS}
DAILY = tuple(one.effect for one in ROWS if one.daily)
RECALIBRATED = {"by": "recalibration"}  # provenance of what recalibration moved
UNWRITTEN = tuple(one.effect for one in ROWS if not one.written)
