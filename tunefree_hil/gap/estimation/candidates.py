"""Who is suspected: every file of effects/ that the plant can have, with what its prior says to search."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from tunefree_hil import effects
from tunefree_hil.base.contracts import Link, Prior, links_of, prior_of
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.gap.estimation.grid import NO_TWIN, TWINS
from tunefree_hil.gap.estimation.least_squares import Free
from tunefree_hil.gap.estimation.nuisance import DRIFT, Nuisance
from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.model.graph import Graph
from tunefree_hil.learn.drives.drive import CHASSIS_FIRST_YAW_RATES

BEYOND = 0.35  # of the prior's width, that a search may go past its ends
LATERAL = "report.lateral_accel_mps2"
NO_GYRO = "no gyro: the chassis's yaw rate is made from its wheels"
# Parameters that mean so many times a constant of the model: as well as that is known
COUNTS_BY = {"rolling_resistance.extra_frac": "rolling_frac", "head_wind.wind_mps": "drag_area_m2"}


class Suspect(NamedTuple):
    """An effect with the parameters to look for."""

    name: str
    free: tuple[Free, ...]
    links: tuple[Link, ...]


def suspects_of(
    graph: Graph, model: ModelSpec, vehicle: VehicleSpec, drives: Sequence[Opened] = ()
) -> tuple[list[Suspect], dict[str, str]]:
    """(suspects, effects that cannot be suspected with the reason): the plant or these drives have none of it."""
    found, cannot = [], dict(graph.cannot)
    if _without_gyro(drives):
        cannot |= {name: NO_GYRO for name, effect in graph.can.items() if links_of(effect)[0] is Link.YAW_VS_INS}
    sizes = sizes_of(model, vehicle, graph)
    for name, effect in graph.can.items():
        if name in cannot:
            continue
        try:
            priors = {key: prior_of(effect, key, sizes) for key in effect.neutral}
        except InputError as error:
            cannot[name] = error.message
            continue
        free = tuple(free_of(f"{name}.{key}", prior, effect.neutral[key]) for key, prior in priors.items())
        found.append(Suspect(name, free, links_of(effect)))
    return found, cannot


def _without_gyro(drives: Sequence[Opened]) -> bool:
    """Whether the chassis's yaw rate is its wheels' in every drive that has one."""
    said = [one for one in drives if one.has(CHASSIS_FIRST_YAW_RATES[0])]
    return bool(said) and all(one.by_wheels for one in said)


def free_of(key: str, prior: Prior, neutral: float) -> Free:
    """A prior as a search takes it: on a logarithmic scale only where it does not cross nought."""
    logarithmic = prior.scale == "log" and prior.low > 0.0
    one = Free(key, prior.low, prior.high, logarithmic, neutral, -BEYOND, 1.0 + BEYOND)
    if not logarithmic and prior.low >= 0.0:
        return one._replace(least=max(-BEYOND, one.place(0.0) + 1e-6))
    return one


def doubted(suspect: Suspect, nuisances: Sequence[Nuisance], doubts: Mapping[str, float]) -> Suspect:
    """A suspect with the doubt about what it takes the place of, recalibration's own number in the same unit, and about
    the constant of the model by which it counts, and with its drift. doubts: standard deviations of the constants'
    logarithms.
    """
    sigmas, drifts = ({one.key: getattr(one, number) for one in nuisances} for number in ("sigma", "drift"))
    # a number of which the model has nothing (no drag) is not recalibrated, and drifts all the same
    drifts = {one.key: drifts.get(one.key, DRIFT.get(one.key, 0.0)) for one in suspect.free}
    known = [sigmas.get(one.key, sigmas.get(TWINS.get(one.key, NO_TWIN)[0], 0.0)) for one in suspect.free]
    return suspect._replace(
        free=tuple(
            one._replace(doubt=sigma, share=doubts.get(COUNTS_BY.get(one.key, ""), 0.0), drift=drifts[one.key])
            for one, sigma in zip(suspect.free, known, strict=True)
        )
    )


def sizes_of(model: ModelSpec, vehicle: VehicleSpec, graph: Graph) -> Mapping[str, float]:
    """The vehicle's own sizes, by which priors are given."""
    params = {**graph.plant.defaults, **model.plant.params}
    nominal = vehicle.nominal
    return {
        "steer_rad": vehicle.limits.steer_rad,
        "mass_kg": nominal.mass_kg or params.get("mass_kg", math.nan),
        "wheelbase_m": nominal.wheelbase_m or params.get("wheelbase_m", math.nan),
    }


def class_of(name: str, has_lateral: bool) -> frozenset[str]:
    """The names that no log of an ordinary drive can tell from this one, itself among them (interfaces 4)."""
    return effects.class_of(name, frozenset() if has_lateral else frozenset({LATERAL}))
