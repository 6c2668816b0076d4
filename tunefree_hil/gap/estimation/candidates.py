"""Candidate effects: every catalogue effect that the plant can have, with the parameters to search."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from tunefree_hil import effects
from tunefree_hil.base.contracts import Link, Prior, links_of, prior_of
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.gap.estimation.grid import NO_TWIN, RECALIBRATION_TWINS
from tunefree_hil.gap.estimation.least_squares import FreeParameter
from tunefree_hil.gap.estimation.nuisance import DRIFT_SIGMAS, Nuisance
from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.model.graph import EffectGraph
from tunefree_hil.gap.selection.reasons import Criterion, Reason, RejectionStage
from tunefree_hil.learn.drives.drive import CHASSIS_FIRST_YAW_RATES

SEARCH_MARGIN = 0.35  # of the prior's width that a search may go beyond its ends
LATERAL_ACCEL = "report.lateral_accel_mps2"
GYRO = "gyro"
# Parameters that are a share of a constant of the model: they are known only as well as it is
SCALING_CONSTANT = {"rolling_resistance.extra_frac": "rolling_frac", "head_wind.wind_mps": "drag_area_m2"}


class Candidate(NamedTuple):
    """An effect with its free parameters and the links of the measured chain that it acts on."""

    name: str
    free: tuple[FreeParameter, ...]
    links: tuple[Link, ...]


def build_candidates(
    graph: EffectGraph, model: ModelSpec, vehicle: VehicleSpec, drives: Sequence[MeasuredDrive] = ()
) -> tuple[list[Candidate], dict[str, Reason]]:
    """Build the candidates for a model and its drives.

    Returns: the candidates; and the reason for each effect that the plant or these drives cannot have
    """
    candidates, stage = list[Candidate](), RejectionStage.UNTESTABLE
    untestable = {
        name: Reason(Criterion.UNSUPPORTED, name, stage=stage, note=message)
        for name, message in graph.unsupported.items()
    }
    if _has_no_gyro(drives):
        untestable |= {
            name: Reason(Criterion.NO_SENSOR, name, key=GYRO, stage=stage)
            for name, effect in graph.supported.items()
            if links_of(effect)[0] is Link.YAW_VS_INS
        }
    sizes = vehicle_sizes(model, vehicle, graph)
    for name, effect in graph.supported.items():
        if name in untestable:
            continue
        try:
            priors = {key: prior_of(effect, key, sizes) for key in effect.neutral}
        except InputError as error:
            untestable[name] = Reason(Criterion.UNSUPPORTED, name, stage=stage, note=error.message)
            continue
        free = tuple(
            free_parameter_from_prior(f"{name}.{key}", prior, effect.neutral[key]) for key, prior in priors.items()
        )
        candidates.append(Candidate(name, free, links_of(effect)))
    return candidates, untestable


def _has_no_gyro(drives: Sequence[MeasuredDrive]) -> bool:
    """Whether the chassis's yaw rate is computed from wheel speeds in every drive that has it."""
    with_yaw_rate = [drive for drive in drives if drive.has_signals(CHASSIS_FIRST_YAW_RATES[0])]
    return bool(with_yaw_rate) and all(drive.has_wheel_yaw_rate for drive in with_yaw_rate)


def free_parameter_from_prior(key: str, prior: Prior, neutral: float) -> FreeParameter:
    """Free parameter of a prior; its scale is logarithmic only where the prior is positive."""
    is_logarithmic = prior.scale == "log" and prior.low > 0.0
    free = FreeParameter(key, prior.low, prior.high, is_logarithmic, neutral, -SEARCH_MARGIN, 1.0 + SEARCH_MARGIN)
    if not is_logarithmic and prior.low >= 0.0:
        return free._replace(u_min=max(-SEARCH_MARGIN, free.u_from_value(0.0) + 1e-6))
    return free


def add_parameter_sigmas(
    candidate: Candidate, nuisances: Sequence[Nuisance], constant_sigmas: Mapping[str, float]
) -> Candidate:
    """Add to each free parameter the doubt of the calibration, the doubt of its scaling constant, and its drift.

    Args:
        nuisances: what recalibration may move; the candidate takes the place of those of the same key, or of its twin
        constant_sigmas: of the logarithms of the model's constants
    """
    by_key = {nuisance.key: nuisance for nuisance in nuisances}

    def add_sigmas(free: FreeParameter) -> FreeParameter:
        same = by_key.get(free.key)
        replaced = same or by_key.get(RECALIBRATION_TWINS.get(free.key, NO_TWIN)[0])
        return free._replace(
            calibration_sigma=replaced.sigma if replaced else 0.0,
            constant_sigma=constant_sigmas.get(SCALING_CONSTANT.get(free.key, ""), 0.0),
            # A parameter that the model does not have (no drag) is not recalibrated, but drifts as well
            drift_sigma=same.drift_sigma if same else DRIFT_SIGMAS.get(free.key, 0.0),
        )

    return candidate._replace(free=tuple(add_sigmas(free) for free in candidate.free))


def vehicle_sizes(model: ModelSpec, vehicle: VehicleSpec, graph: EffectGraph) -> Mapping[str, float]:
    """Sizes of the vehicle by which priors are scaled."""
    params = {**graph.plant.defaults, **model.plant.params}
    nominal = vehicle.nominal
    return {
        "steer_rad": vehicle.limits.steer_rad,
        "mass_kg": nominal.mass_kg or params.get("mass_kg", math.nan),
        "wheelbase_m": nominal.wheelbase_m or params.get("wheelbase_m", math.nan),
    }


def indistinguishable_effects(name: str, has_lateral: bool) -> frozenset[str]:
    """Names that no log of an ordinary drive distinguishes from this one, itself among them."""
    return effects.class_of(name, frozenset() if has_lateral else frozenset({LATERAL_ACCEL}))
