"""From a family and a request to a scenario: shrunk until it keeps to its limits, rounded, named and hashed."""

from __future__ import annotations

import hashlib
from random import Random
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.dump import plain, to_toml
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec, StartSpec, with_source
from tunefree_hil.roads.check import LimitExcess, RoadQuantity, excess_text, find_excesses
from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families import RoadFamily
from tunefree_hil.roads.limits import RoadLimits

ATTEMPTS = 16  # a request shrinks to a tenth within them
SHRINK = 0.87  # factor on what was too much
STRETCH = 1.12  # factor on the time of ramps
SCENARIO_SCHEMA = "tunefree.scenario/1"
NOISE_SEEDS = 65536
# Digits behind the point. Coarser than the last bits of sin and cos, which differ between machines.
SPEED_DIGITS, CURVATURE_DIGITS, ANGLE_DIGITS, FRICTION_DIGITS, WIND_DIGITS = 4, 6, 5, 3, 3

LATERAL = {RoadQuantity.CURVATURE, RoadQuantity.LATERAL_ACCEL}
LONGITUDINAL = {RoadQuantity.ACCEL, RoadQuantity.DECEL}
RATES = {RoadQuantity.JERK, RoadQuantity.LATERAL_JERK, RoadQuantity.CURVATURE_RATE}


class RoadStartCriteria(NamedTuple):
    """How far beside its road a vehicle starts: evenly drawn, either way."""

    max_lateral_m: float = 0.2  # m; what a driver leaves when the controller takes over
    max_heading_rad: float = 0.02  # rad; about one degree
    max_drift_mps: float = 0.2  # m/s to the side; bounds the heading at speed
    max_speed_mps: float = 0.2  # m/s beside the planned speed


START = RoadStartCriteria()


class RoadLabel(NamedTuple):
    """What makes a road of a set unique.

    Attributes:
        tag: Set and seed in the name, such as 's1'.
        number: Place in the set.
        stream: Seed of the road's shape, in words; start and noise depend on the tag too.
    """

    tag: str
    number: int
    stream: str


def make_road(
    family: RoadFamily, request: RoadRequest, limits: RoadLimits, label: RoadLabel, offsets: bool = True
) -> ScenarioSpec:
    """A road of the family, within the limits.

    Args:
        offsets: Whether the vehicle starts a little beside the road.

    Raises:
        InputError: No road within the limits after a bounded number of smaller requests.
    """
    request, draft = _fit(family, request, limits, label)
    name = f"{family.name}_{request.speed_mps:.0f}mps_{label.tag}_{label.number:02d}"
    chance = Random(f"start {label.tag} {label.stream}")
    seed = chance.randrange(NOISE_SEEDS)
    start = _draw_start(float(draft.speed_mps[0]), limits, chance) if offsets else _plain_start(draft)
    spec = ScenarioSpec(
        schema=SCENARIO_SCHEMA,
        name=name,
        description=draft.description,
        noise_seed=seed,
        start=start,
        speed=_profile(draft.time_s, draft.speed_mps, SPEED_DIGITS),
        curvature=_profile(draft.time_s, draft.curvature_1pm, CURVATURE_DIGITS),
        grade=_road_profile(draft, draft.grade_rad, ANGLE_DIGITS),
        friction=_road_profile(draft, draft.friction_frac, FRICTION_DIGITS),
        bank=_road_profile(draft, draft.bank_rad, ANGLE_DIGITS),
        side_wind=_road_profile(draft, draft.side_wind_mps2, WIND_DIGITS),
    )
    return _with_hash(spec)


def scenario_text(spec: ScenarioSpec) -> str:
    """The scenario file of a made road; the road's hash is that of these bytes."""
    data = plain(spec)
    return to_toml({key: value for key, value in data.items() if key not in ("path", "hash")})


def _with_hash(spec: ScenarioSpec) -> ScenarioSpec:
    digest = hashlib.sha256(scenario_text(spec).encode()).hexdigest()
    return with_source(spec, "", digest)


def _fit(
    family: RoadFamily, request: RoadRequest, limits: RoadLimits, label: RoadLabel
) -> tuple[RoadRequest, RoadDraft]:
    """The first request, each smaller than the one before, whose road keeps to the limits, and the road."""
    excesses: list[LimitExcess] = []
    for _ in range(ATTEMPTS):
        draft = family.build(request, limits, Random(label.stream))  # the same chance: only the request shrinks
        excesses = find_excesses(draft, limits)
        if not excesses:
            return request, draft
        request = _shrink(request, {excess.quantity for excess in excesses})
    problems = "; ".join(excess_text(excess) for excess in excesses)
    raise InputError(
        f"no road of the family {family.name} at {request.speed_mps:.1f} m/s within the vehicle's limits: {problems}",
        code="infeasible_road",
        key="roads",
        hint="check [limits] and [nominal] of vehicle.toml, or name scenarios instead",
    )


def _shrink(request: RoadRequest, quantities: set[RoadQuantity]) -> RoadRequest:
    """A smaller request for what was too much."""
    lateral = LATERAL | {RoadQuantity.GRIP}
    longitudinal = LONGITUDINAL | {RoadQuantity.GRIP}
    if quantities & lateral:
        request = request._replace(lateral_accel_mps2=SHRINK * request.lateral_accel_mps2)
    if quantities & longitudinal:
        request = request._replace(longitudinal_share=SHRINK * request.longitudinal_share)
    if quantities & RATES:
        request = request._replace(ease=STRETCH * request.ease)
    if RoadQuantity.DURATION in quantities:  # a stronger change of speed is a shorter one
        share = request.longitudinal_share
        speed = request.speed_mps if share < 1.0 else SHRINK * request.speed_mps
        request = request._replace(longitudinal_share=min(share / SHRINK, 1.0), speed_mps=speed)
    return request


def _draw_start(speed_mps: float, limits: RoadLimits, chance: Random) -> StartSpec:
    heading = min(START.max_heading_rad, START.max_drift_mps / max(speed_mps, 1.0))
    faster = chance.uniform(-START.max_speed_mps, START.max_speed_mps) if speed_mps > 0.0 else 0.0
    return StartSpec(
        lateral_m=round(chance.uniform(-START.max_lateral_m, START.max_lateral_m), 3),
        heading_rad=round(chance.uniform(-heading, heading), 4),
        speed_mps=round(min(max(speed_mps + faster, 0.0), limits.speed_mps), 3),
    )


def _plain_start(draft: RoadDraft) -> StartSpec:
    return StartSpec(speed_mps=round(float(draft.speed_mps[0]), SPEED_DIGITS))


def _road_profile(draft: RoadDraft, values: np.ndarray | None, digits: int) -> ProfileSpec | None:
    return None if values is None else _profile(draft.time_s, values, digits)


def _profile(time_s: np.ndarray, values: np.ndarray, digits: int) -> ProfileSpec:
    """Breakpoints of a signal; those inside a stretch of equal values are left out."""
    rounded = np.round(values, digits) + 0.0  # + 0.0: no negative zero
    inner = (rounded[1:-1] != rounded[:-2]) | (rounded[1:-1] != rounded[2:])
    used = np.concatenate([[True], inner, [True]])
    return ProfileSpec(t_s=np.round(time_s[used], 1).tolist(), value=rounded[used].tolist())
