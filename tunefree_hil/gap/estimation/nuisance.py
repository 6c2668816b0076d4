"""Nuisance parameters: what recalibration may move, within the doubt of the model's calibration and the drift of a day.

A car changes a little from one day to the next. A search that held all else fixed would call each such change an
effect. So every candidate model, and the recalibrated model without effects, may move these parameters within their
priors. Most of them are parameters of catalogue effects near neutral, and mean the same on every kind of plant. An
effect that is itself a candidate has no such prior.

`DRIFTS` lists what drifts: how much, how well a calibration knows it, and whether it belongs to the day or to the car.
The values are explained in docs/results/criteria.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tunefree_hil.config.schema import ActuatorSpec, Interval, ModelSpec, Number, value_of
from tunefree_hil.gap.model.card import card_error, load_model_card
from tunefree_hil.gap.model.graph import (
    CHANNELS,
    LINKAGE_BEND_KEY,
    LINKAGE_BEND_PARAM,
    EffectGraph,
    channel_spec_from_model,
    has_channel,
)
from tunefree_hil.learn.data_sheet import PRIORS

Array = np.ndarray


class Nuisance(NamedTuple):
    """A parameter that recalibration may move.

    Args:
        key: as `EffectGraph.simulate` takes it
        neutral: value without any change
        sigma: standard deviation of its prior, in its unit
        calibration_sigma: the part of `sigma` that is the same every day: the doubt of the calibration
        constant: the constant of the plant whose doubt that is; "" for none
        sign: -1.0 where more of it is less of the constant
        drift_sigma: the part of `sigma` that may change from day to day
    """

    key: str
    neutral: float
    sigma: float
    calibration_sigma: float = 0.0
    constant: str = ""
    sign: float = 1.0
    drift_sigma: float = 0.0


class NuisanceCriteria(NamedTuple):
    """Limits of the priors of nuisance parameters (docs/results/criteria.md)."""

    # of the drift that recalibration may move of a model that reproduces its logs; larger changes are looked for by
    # name
    min_drift_share: float = 0.25
    # speed error up to which a model reproduces its logs: of `calibrate` over free runs of a few seconds, of
    # `learn` after 10 s on held-out stretches
    exact_speed_rms_mps: float = 0.06
    # of a calibration's own deviation: two equally good determinations differ by this
    calibration_sigma_factor: float = math.sqrt(2.0)
    max_constant_sigma: float = 0.15  # largest doubt of a constant, as a share of it
    drag_sigmas_to_zero: float = 3.1  # standard deviations from the drag area to zero, below which there is no car
    min_dead_time_sigma_s: float = 0.001  # no channel's dead time is known better on another day
    min_lag_sigma: float = 0.01  # the same of its lag, as a share
    min_gain_sigma: float = 0.0005  # the same of its gain, as a share
    min_offset_sigma: float = 5e-5  # the same of its offset, duty or rad
    max_channel_sigma: float = 0.3  # largest share by which a channel's lag or gain may be off
    # of the road wheels' linkage per rad², where it was not calibrated; half of its prior
    max_bend_sigma: float = 0.5 * PRIORS.linkage_bend_per_rad2
    min_bend_sigma: float = 0.08  # of the same per rad², however well it was calibrated


CRITERIA = NuisanceCriteria()
FREE_RUN_HORIZON_KEY = "10"  # of `learn`'s card: errors after 10 s
BRAKE_RISE = "brake_rise_per_frac"
# Constants of the plant: standard deviation of the logarithm, or of the constant itself (ABSOLUTE_CONSTANTS)
CONSTANT_SIGMAS: dict[str, float] = {
    "drive_force_n": 0.01,  # the gain of the throttle, a nuisance too, does nearly the same
    "drive_knee_frac": 0.04,
    "creep_speed_mps": 0.05,
    "drive_power_w": 0.02,
    "drive_corner": 0.05,
    "throttle_zero_frac": 0.002,
    "creep_force_n": 0.05,
    "overrun_force_n": 0.05,
    BRAKE_RISE: 0.0,  # it does not drift: only what the calibration leaves open
    "yaw_inertia_kgm2": 0.03,
    "front_axle_m": 0.04,  # from the data sheet; no calibration moves it
    "wheelbase_m": 0.008,
}
ABSOLUTE_CONSTANTS = {"throttle_zero_frac", BRAKE_RISE}  # their doubt is in their own unit, that of the others a share
# Constants that may be zero: a calibration's deviation is in their own unit
ZERO_ALLOWED = {LINKAGE_BEND_PARAM, BRAKE_RISE}
# A calibration knows a combination of these constants much better than each of them. Where its card does not hold their
# correlation, their doubt must not move one of them alone.
JOINTLY_KNOWN = {
    "drive_force_n",
    "drive_knee_frac",
    "drive_corner",
    "overrun_force_n",
    "rolling_frac",
    "drag_area_m2",
    "throttle_zero_frac",
}
# Standard deviation of the time at which the values of a frame were measured, s: part of a tick or of a bus's queue
CLOCK_SIGMAS = {"clock.throttle_s": 0.004, "clock.brake_s": 0.004, "clock.steer_s": 0.004, "clock.ins_s": 0.004}


def build_nuisances(
    graph: EffectGraph, model: ModelSpec, constant_sigmas: Mapping[str, float], drift_share: float = 1.0
) -> list[Nuisance]:
    """Build the nuisance parameters that a model's plant has.

    Args:
        constant_sigmas: of the logarithms of its constants (`read_constant_sigmas`)
        drift_share: share of the day-to-day drift that may be moved (`read_drift_share`)
    """
    params = {**graph.plant.defaults, **model.plant.params}
    drifts = [
        (drift, graph.supported[drift.effect].neutral[drift.parameter])
        for drift in DRIFTS
        if drift.effect in graph.supported
    ]
    drifts += [
        (Drift("plant", name, sigma, "", name, is_absolute=name in ABSOLUTE_CONSTANTS), 0.0)
        for name, sigma in CONSTANT_SIGMAS.items()
        if params.get(name, 0.0) > 0.0 or name in ABSOLUTE_CONSTANTS & params.keys()  # a share of zero is zero
    ]
    nuisances = []
    for drift, neutral in drifts:
        nuisance = _nuisance_from_drift(drift, neutral, params, constant_sigmas, drift_share)
        if nuisance.sigma > 0.0:
            nuisances.append(nuisance)
    nuisances += [Nuisance(key, 0.0, sigma) for key, sigma in CLOCK_SIGMAS.items()]
    if LINKAGE_BEND_PARAM in graph.plant.defaults:  # no other plant has this parameter
        nuisances.append(_linkage_nuisance(constant_sigmas))
    for channel in CHANNELS:
        nuisances += _channel_nuisances(
            channel, channel_spec_from_model(model, channel) if has_channel(model, channel) else None
        )
    return nuisances


def _nuisance_from_drift(
    drift: Drift, neutral: float, params: Mapping[str, float], constant_sigmas: Mapping[str, float], drift_share: float
) -> Nuisance:
    mass_ratio = params.get("mass_kg", ROAD_CAR_KG) / ROAD_CAR_KG
    constant = drift.constant
    drift_sigma = (
        drift.sigma * (mass_ratio if drift.scales_with_mass else 1.0) * (1.0 if drift.is_daily else drift_share)
    )
    calibration_sigma = min(
        CRITERIA.calibration_sigma_factor * constant_sigmas.get(constant, 0.0), CRITERIA.max_constant_sigma
    )
    is_share = drift.is_absolute and constant not in ZERO_ALLOWED
    calibration_sigma *= params.get(constant, 0.0) if is_share else 1.0
    # A car driven by acceleration requests shows no drag of its own, and no car has a negative drag
    max_sigma = math.inf
    if constant == "drag_area_m2":
        max_sigma = params.get(constant, math.inf) / CRITERIA.drag_sigmas_to_zero
    sigma = min(math.hypot(drift_sigma, calibration_sigma), max_sigma)
    if drift.absorbs_model_form:
        calibration_sigma = sigma * math.sqrt(1.0 - drift_share**2)
    sign = -1.0 if drift.is_inverse else 1.0
    return Nuisance(drift.key, neutral, sigma, min(calibration_sigma, sigma), constant, sign, drift_sigma)


def _linkage_nuisance(constant_sigmas: Mapping[str, float]) -> Nuisance:
    calibration_sigma = CRITERIA.calibration_sigma_factor * constant_sigmas.get(
        LINKAGE_BEND_PARAM, CRITERIA.max_bend_sigma
    )
    sigma = min(math.hypot(CRITERIA.min_bend_sigma, calibration_sigma), CRITERIA.max_bend_sigma)
    return Nuisance(LINKAGE_BEND_KEY, 0.0, sigma, min(calibration_sigma, sigma), LINKAGE_BEND_PARAM)


def read_constant_sigmas(model: ModelSpec) -> dict[str, float]:
    """Read how well `calibrate` knows a model's constants, from its card.

    Returns: standard deviations of their logarithms, of ZERO_ALLOWED of the constants themselves; empty without a card.
    Raises: InputError for an invalid card.
    """
    correlations = read_constant_correlations(model)
    try:
        return {
            name: (entry["high"] - entry["low"] if name in ZERO_ALLOWED else math.log(entry["high"] / entry["low"]))
            / 3.92
            for name, entry in load_model_card(model).get("constants", {}).items()
            if isinstance(entry, dict) and entry.get("high", 0.0) > entry.get("low", 0.0)
            if entry.get("low", 0.0) > 0.0 or name in ZERO_ALLOWED
            if name in correlations or name not in JOINTLY_KNOWN
        }
    except (AttributeError, TypeError, KeyError) as error:
        raise card_error(Path(model.folder) / model.plant.card, error) from error


def read_constant_correlations(model: ModelSpec) -> dict[str, dict[str, float]]:
    """Read the correlations of the doubts of a model's constants, by name and name; empty where the card has none.

    Raises: InputError for an invalid card.
    """
    try:
        entry = load_model_card(model).get("constants_together") or {"names": [], "correlation": []}
        rows = zip(entry["names"], entry["correlation"], strict=True)
        return {name: {other: float(r) for other, r in zip(entry["names"], row, strict=True)} for name, row in rows}
    except (AttributeError, TypeError, KeyError, ValueError) as error:
        raise card_error(Path(model.folder) / model.plant.card, error) from error


def read_drift_share(model: ModelSpec, pace: float = 1.0) -> float:
    """Share of the day-to-day drift that recalibration may move, by how well the model reproduces its calibration logs.

    A model that does reproduce them (`exact_speed_rms_mps`) is right about its car throughout. One that misses more, or
    whose card does not tell, may move a larger share: what it misses there it will miss here, and that is no effect.

    Args:
        pace: speed of a model car as a share of a road car's

    Raises: InputError for an invalid card.
    """
    card = load_model_card(model)
    try:
        if "free_run_rms" in card:
            is_calibrated = any(entry["known"] for entry in card["constants"].values())
            speed_rms = card["free_run_rms"]["training"]["fitted"]["speed_mps"] if is_calibrated else None
        else:
            runs = card.get("free_run", {}).get(card.get("kind"), {})
            key = FREE_RUN_HORIZON_KEY
            speed_rms = max(
                (run[key]["speed_mps"]["mean"] for run in runs.values() if key in (run or ())), default=None
            )
        unit_mps = pace * CRITERIA.exact_speed_rms_mps / CRITERIA.min_drift_share
        share = math.inf if speed_rms is None else float(speed_rms) / unit_mps
    except (AttributeError, TypeError, KeyError, ValueError) as error:
        raise card_error(Path(model.folder) / model.plant.card, error) from error
    return min(max(share, CRITERIA.min_drift_share), 1.0)


def prior_correlation(nuisances: Sequence[Nuisance], constant_correlations: Mapping[str, Mapping[str, float]]) -> Array:
    """Correlation of the priors, shape (n_nuisances, n_nuisances): that of the calibration; drifts are independent."""
    correlation = np.eye(len(nuisances))
    for i, a in enumerate(nuisances):
        for j, b in enumerate(nuisances[:i]):
            share = a.sign * b.sign * a.calibration_sigma * b.calibration_sigma / (a.sigma * b.sigma)
            related = constant_correlations.get(a.constant, {}).get(b.constant, 0.0)
            correlation[i, j] = correlation[j, i] = share * related
    return correlation


def _channel_nuisances(channel: str, spec: ActuatorSpec | None) -> list[Nuisance]:
    """Parameters of an actuator within their 95 % intervals, but never known better than on another day."""
    if spec is None:
        return []
    nuisances = [
        _added_nuisance(channel, "dead_time_s", spec.dead_time_s, CRITERIA.min_dead_time_sigma_s),
        _added_nuisance(channel, "offset", spec.offset, CRITERIA.min_offset_sigma),
    ]
    names = ("lag_s",) if spec.order == 1 else ("natural_hz", "damping")
    for name in (*names, "gain"):
        number = getattr(spec, name)
        value = value_of(number)
        if value > 0.0:
            min_sigma = CRITERIA.min_gain_sigma if name == "gain" else CRITERIA.min_lag_sigma
            sigma = max(_standard_deviation(number) / value, min_sigma)
            nuisances.append(Nuisance(f"actuator.{channel}.{name}", 0.0, min(sigma, CRITERIA.max_channel_sigma)))
    return nuisances


def _added_nuisance(channel: str, name: str, number: Number, min_sigma: float) -> Nuisance:
    sigma = max(_standard_deviation(number), min_sigma)
    return Nuisance(f"actuator.{channel}.{name}", 0.0, sigma)


def _standard_deviation(number: Number) -> float:
    """Of a number with a 95 % interval; 0 of one without."""
    return (number.high - number.low) / 3.92 if isinstance(number, Interval) else 0.0


class Drift(NamedTuple):
    """What changes in a car from one day to the next, as a parameter of a catalogue effect.

    Args:
        effect: name of the effect
        parameter: its parameter
        sigma: standard deviation from day to day, in the parameter's unit
        reason: what changes
        constant: constant of the plant (card of `calibrate`) whose doubt adds to it; "" for none
        is_absolute: that doubt is in the constant's own unit, not a share of it
        is_inverse: more of it is less of the constant
        is_daily: it belongs to the day, not to the car: no calibration removes it, however exact the model is
        absorbs_model_form: recalibration also compensates by it what the model's form lacks, the same every day
        is_written: it goes into a repaired model; changes of the day, of sensors and of tyres do not
        scales_with_mass: `sigma` is that of a car of ROAD_CAR_KG, and proportional to the mass
        is_lateral: it shows in yaw rate and lateral acceleration
    """

    effect: str
    parameter: str
    sigma: float
    reason: str
    constant: str = ""
    is_absolute: bool = False
    is_inverse: bool = False
    is_daily: bool = False
    absorbs_model_form: bool = False
    is_written: bool = True
    scales_with_mass: bool = False
    is_lateral: bool = False

    @property
    def key(self) -> str:
        """As `EffectGraph.simulate` takes it."""
        return f"{self.effect}.{self.parameter}"


ROAD_CAR_KG = 1800.0
TYRES = "tyre pressure, temperature"
DRIFTS = (
    Drift("throttle_gain", "gain_frac", 0.02, "fuel, temperature of the engine"),
    Drift("brake_gain", "gain_frac", 0.02, "temperature of the discs", "brake_force_n_per_frac"),
    Drift("steer_gain", "gain_frac", 0.01, "error of a calibrated steering ratio", "steer_ratio", is_inverse=True),
    Drift("steer_offset", "offset_rad", 0.003, "straight ahead, as a calibration finds it"),
    Drift("rolling_resistance", "extra_frac", 0.06, TYRES, "rolling_frac"),
    Drift("aero_drag", "drag_area_m2", 0.03, "error of calibration at town speeds", "drag_area_m2", is_absolute=True),
    # Grip belongs to the day; a model also compensates by it the form of its tyre curve, which no calibration does
    Drift(
        "friction",
        "friction_frac",
        0.15,
        "grip of the road, which is not measured",
        is_daily=True,
        absorbs_model_form=True,
        is_written=False,
        is_lateral=True,
    ),
    Drift("front_stiffness", "gain_frac", 0.02, TYRES, "front_stiffness_n_per_rad", is_lateral=True),
    Drift("rear_stiffness", "gain_frac", 0.02, TYRES, "rear_stiffness_n_per_rad", is_lateral=True),
    Drift("grade", "grade_rad", 0.0007, "slope of a level road", is_daily=True, is_written=False),
    Drift(
        "side_wind",
        "force_n",
        8.0,
        "camber of a level road, light wind",
        is_daily=True,
        is_written=False,
        scales_with_mass=True,
        is_lateral=True,
    ),
    Drift("speed_scale", "scale_frac", 0.001, "rolling radius", is_written=False),
    Drift("yaw_rate_bias", "bias_radps", 0.0003, "gyro bias at each start", is_daily=True, is_written=False),
    Drift("yaw_rate_scale", "scale_frac", 0.002, "gyro scale", is_written=False),
    Drift("accel_bias", "bias_mps2", 0.008, "accelerometer bias at each start", is_daily=True, is_written=False),
)
DRIFT_BY_KEY = {drift.key: drift for drift in DRIFTS}
DRIFT_SIGMAS = {drift.key: drift.sigma for drift in DRIFTS}
DAILY_EFFECTS = tuple(drift.effect for drift in DRIFTS if drift.is_daily)
UNWRITTEN_EFFECTS = tuple(drift.effect for drift in DRIFTS if not drift.is_written)
RECALIBRATED = {"by": "recalibration"}  # provenance of parameters that recalibration moved
