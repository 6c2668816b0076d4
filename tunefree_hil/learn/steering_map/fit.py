"""Fits the coefficients of a steering map to samples of nearly steady driving.

    wheel = offset + ratio (length kappa + length_3 kappa^3 + understeer a + understeer_3 a^3) + dead zone sign(kappa)

Linear in the coefficients. Three more columns take out what a change of the turn adds in first order. A coefficient is
fitted where the data cover it and its interval is narrow; otherwise it keeps the value of `base` and says why. The
wheelbase and the place of the rear axle are known from the data sheet; the steering ratio takes up what is left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from tunefree_hil.control.steering_map import SteeringMap
from tunefree_hil.learn.estimate import Estimate
from tunefree_hil.learn.steering_map.regression import BlockRegression, fit_blocks, jackknife_half_width
from tunefree_hil.learn.steering_map.samples import SteadySamples

Array = np.ndarray
NOISE_FLOOR_RAD = 0.002  # of a steering wheel's report: 0.1 degree of resolution
SLIP_FLOOR_RAD = 0.0005  # of an INS's heading
START_ZONE_RAD, ZONE_ROUNDS = 0.03, 5  # the width of the dead zone settles after three
BOUNDS = ("curvature_bound_1pm", "lateral_accel_bound_mps2")


class SteeringMapCriteria(NamedTuple):
    """When a coefficient of the steering map is fitted; without a source a value is an engineering choice."""

    min_turning_blocks: int = 8  # stretches with turning; fewer give no interval
    min_turning_wheel_rad: float = 0.15  # rad of steering wheel from which on a sample turns
    min_curvature_1pm: float = 0.01  # 1/m, covered to either side, for the ratio
    min_lateral_accel_mps2: float = 1.2  # m/s2, covered to either side, for understeer and rear slip
    min_cubic_curvature_1pm: float = 0.08  # 1/m: 2 % of the wheel angle is cubic from here on, for a wheelbase of 2.8 m
    min_cubic_lateral_accel_mps2: float = 2.0  # m/s2: the van of bench_configs shows its saturation from here on
    # of a coefficient, added to the half of its interval: scale errors of speed and yaw rate, and the map's own form
    systematic_share: float = 0.005
    systematic_cubic_share: float = 0.05  # the same of a cubic coefficient, which takes up all higher orders
    coverage_share: float = 0.005  # of the samples on either side, beyond the covered value
    max_ratio_half_width: float = 0.04  # of the ratio: the interval
    max_slip_half_width_s2pm: float = 0.001  # s2/m: 8 % of a wheel angle at 15 m/s
    max_offset_half_width_rad: float = 0.03  # rad of steering wheel: 2 mrad at the road wheel, 1 cm of lateral error
    min_dead_zone_rad: float = 0.004  # rad of steering wheel: two steps of a usual report
    max_dead_zone_rad: float = 0.3  # rad: more is no dead zone but another steering
    max_lone_ratio_mps: float = 5.0  # m/s: 0.004 s2/m of understeer are 3 % of the wheel angle here
    dead_zone_spans: float = 2.0  # half widths about straight ahead that do not show the dead zone


CRITERIA = SteeringMapCriteria()


class SteeringTerm(Enum):
    """A term that may be fitted; the value is the field of SteeringMap."""

    RATIO = "steer_ratio"
    OFFSET = "offset_rad"
    DEAD_ZONE = "dead_zone_rad"
    LENGTH_CUBIC = "length_cubic_m3"
    UNDERSTEER = "understeer_s2pm"
    UNDERSTEER_CUBIC = "understeer_cubic_s6pm3"
    REAR_SLIP = "rear_slip_s2pm"


# Left out where the data show none of it.
OPTIONAL = (SteeringTerm.DEAD_ZONE, SteeringTerm.LENGTH_CUBIC, SteeringTerm.UNDERSTEER_CUBIC)
NEVER_FITTED = {
    "length_m": "the wheelbase; the ratio takes up what is left of it",
    "rear_axle_m": "geometry",
}


class SteeringCoverage(NamedTuple):
    """What the samples cover; curvature and lateral acceleration to either side, the smaller of both."""

    speed_low_mps: float
    speed_high_mps: float
    curvature_1pm: float
    lateral_accel_mps2: float
    turning_blocks: int


class SteeringFit(NamedTuple):
    """A fitted map.

    Attributes:
        steering: The map.
        estimates: By field of SteeringMap without its bounds.
        coverage: What was driven.
        replicates: The map without each block, in the order of the blocks; empty where nothing is fitted.
        residual_rad: RMS of measured minus fitted wheel angle.
        samples: All samples.
        n_blocks: Number of stretches with samples.
    """

    steering: SteeringMap
    estimates: Mapping[str, Estimate]
    coverage: SteeringCoverage
    replicates: tuple[SteeringMap, ...]
    residual_rad: float
    samples: SteadySamples
    n_blocks: int

    @property
    def fitted(self) -> tuple[str, ...]:
        """The coefficients that the data identify."""
        return tuple(name for name, estimate in self.estimates.items() if estimate.known)


class TurnGeometry(NamedTuple):
    """Curvature at the centre of mass, and lateral acceleration v^2 kappa, shape (n_samples,)."""

    curvature_1pm: Array
    lateral_mps2: Array


class _SteadyTurns(NamedTuple):
    """What a fit is made of. base: values of what is not fitted."""

    samples: SteadySamples
    geometry: TurnGeometry
    coverage: SteeringCoverage
    base: SteeringMap


class _Solved(NamedTuple):
    """A regression of the wheel angle and its terms in the order of the columns; `used` samples are not near zero."""

    terms: tuple[SteeringTerm, ...]
    regression: BlockRegression
    value: SteeringMap
    replicates: tuple[SteeringMap, ...]


def fit_steering_map(samples: SteadySamples, base: SteeringMap, base_label: str) -> SteeringFit:
    """Fit what the samples can tell.

    Args:
        samples: Of all drives.
        base: Values of what is not fitted.
        base_label: Where they come from, such as 'the data sheet'.
    """
    geometry = locate_turns(samples, base)
    coverage = measure_coverage(samples, geometry.curvature_1pm, geometry.lateral_mps2, base)
    reasons: dict[SteeringTerm, str] = {}
    slip = _fit_rear_slip(_SteadyTurns(samples, geometry, coverage, base), reasons)
    if slip is not None:
        base = base._replace(rear_slip_s2pm=slip.value)
        geometry = locate_turns(samples, base)
    solved = _fit_wheel(_SteadyTurns(samples, geometry, coverage, base), reasons)
    steering = base if solved is None else solved.value
    terms = () if solved is None else solved.terms
    steering = steering._replace(
        curvature_bound_1pm=coverage.curvature_1pm if SteeringTerm.LENGTH_CUBIC in terms else base.curvature_bound_1pm,
        lateral_accel_bound_mps2=coverage.lateral_accel_mps2,
    )
    replicates = () if solved is None else tuple(_with_bounds(one, steering) for one in solved.replicates)
    fitted = {term: _estimate_term(steering, replicates, term) for term in terms}
    fitted |= {} if slip is None else {SteeringTerm.REAR_SLIP: slip}
    estimates = _list_estimates(steering, fitted, reasons, base_label)
    residual = float(np.sqrt(np.mean(solved.regression.residuals**2))) if solved is not None else 0.0
    n_blocks = len(np.unique(samples.block))
    return SteeringFit(steering, estimates, coverage, replicates, residual, samples, n_blocks)


def measure_coverage(samples: SteadySamples, curvature: Array, lateral: Array, base: SteeringMap) -> SteeringCoverage:
    """What the samples cover."""
    if not len(curvature):
        return SteeringCoverage(0.0, 0.0, 0.0, 0.0, 0)
    turns = np.abs(base.steer_ratio * base.length_m * curvature) >= CRITERIA.min_turning_wheel_rad
    share = CRITERIA.coverage_share

    def reach(values: Array) -> float:
        left, right = np.quantile(values, 1.0 - share), -np.quantile(values, share)
        return float(max(min(left, right), 0.0))

    return SteeringCoverage(
        float(samples.speed_mps.min()),
        float(samples.speed_mps.max()),
        reach(curvature),
        reach(lateral),
        len(np.unique(samples.block[turns])),
    )


def locate_turns(samples: SteadySamples, base: SteeringMap) -> TurnGeometry:
    """Curvature at the centre of mass, from speed and yaw rate at the rear axle and the slip angle there."""
    v, r = samples.speed_mps, samples.yaw_rate_radps
    sideways = base.rear_axle_m * r / v - base.rear_slip_s2pm * v * r  # tangent of the side-slip angle
    curvature = r / v / np.sqrt(1.0 + sideways * sideways)
    return TurnGeometry(curvature, v * v * curvature)


def _fit_rear_slip(turns: _SteadyTurns, reasons: dict[SteeringTerm, str]) -> Estimate | None:
    """Slip angle of the rear axle per lateral acceleration, with a constant for how the INS is mounted."""
    samples, coverage = turns.samples, turns.coverage
    rows = np.isfinite(samples.rear_slip_rad)
    if not rows.any():
        reasons[SteeringTerm.REAR_SLIP] = "no position and heading of the rear axle in the data"
        return None
    if why := _uncovered(coverage.lateral_accel_mps2, CRITERIA.min_lateral_accel_mps2, "m/s2", coverage):
        reasons[SteeringTerm.REAR_SLIP] = why
        return None
    slip = samples.select(rows)
    lateral = turns.geometry.lateral_mps2[rows]
    columns = np.stack([-lateral, np.ones(len(lateral)), slip.yaw_accel_radps2], axis=1)
    weights = slip.speed_mps**2 / np.mean(slip.speed_mps**2)  # the course is the better the longer the way
    fit = fit_blocks(columns, slip.rear_slip_rad, slip.block, SLIP_FLOOR_RAD, weights)
    spread = float(jackknife_half_width(fit.without_block[:, 0]))
    half = math.hypot(spread, CRITERIA.systematic_share * abs(float(fit.solution[0])))
    if not fit.is_determined or half > CRITERIA.max_slip_half_width_s2pm:
        reasons[SteeringTerm.REAR_SLIP] = f"the data leave it open by {half:.2g} s2/m to either side"
        return None
    value = float(fit.solution[0])
    return Estimate(value, value - half, value + half)


def _uncovered(reached: float, needed: float, unit: str, coverage: SteeringCoverage) -> str:
    """Why a term is not covered; '' where it is."""
    if coverage.turning_blocks < CRITERIA.min_turning_blocks:
        return f"turning in {coverage.turning_blocks} stretches of driving, needed are {CRITERIA.min_turning_blocks}"
    if reached < needed:
        return f"covered to {reached:.2g} {unit} to both sides, needed are {needed:g} {unit}"
    return ""


def _candidates(coverage: SteeringCoverage, reasons: dict[SteeringTerm, str]) -> tuple[SteeringTerm, ...]:
    """The terms that the data cover; the others get a reason."""
    curvature, lateral = coverage.curvature_1pm, coverage.lateral_accel_mps2
    needs = {
        SteeringTerm.RATIO: (curvature, CRITERIA.min_curvature_1pm, "1/m"),
        SteeringTerm.OFFSET: (curvature, 0.0, "1/m"),
        SteeringTerm.DEAD_ZONE: (curvature, CRITERIA.min_curvature_1pm, "1/m"),
        SteeringTerm.LENGTH_CUBIC: (curvature, CRITERIA.min_cubic_curvature_1pm, "1/m"),
        SteeringTerm.UNDERSTEER: (lateral, CRITERIA.min_lateral_accel_mps2, "m/s2"),
        SteeringTerm.UNDERSTEER_CUBIC: (lateral, CRITERIA.min_cubic_lateral_accel_mps2, "m/s2"),
    }
    missing = {term: why for term, need in needs.items() if (why := _uncovered(*need, coverage))}
    reasons.update(missing)
    return tuple(term for term in needs if term not in missing)


def _fit_wheel(turns: _SteadyTurns, reasons: dict[SteeringTerm, str]) -> _Solved | None:
    """Fit all covered terms, and drop one after the other until each is worth its place; None without any."""
    coverage = turns.coverage
    terms = _without_lone_ratio(_candidates(coverage, reasons), coverage, reasons)
    while terms:
        solved = _solve(terms, turns)
        weak = _weakest(solved, turns.base)
        if weak is None:
            return solved
        reasons[weak.term] = weak.reason
        terms = _without_lone_ratio(tuple(term for term in terms if term is not weak.term), coverage, reasons)
    return None


def _without_lone_ratio(
    terms: tuple[SteeringTerm, ...], coverage: SteeringCoverage, reasons: dict[SteeringTerm, str]
) -> tuple[SteeringTerm, ...]:
    """Without understeer a ratio fitted at speed takes up the understeer, and is wrong at any other speed."""
    if SteeringTerm.RATIO not in terms or SteeringTerm.UNDERSTEER in terms:
        return terms
    if coverage.speed_high_mps <= CRITERIA.max_lone_ratio_mps:
        return terms
    reasons[SteeringTerm.RATIO] = "cannot be told from understeer in these data"
    kept = (SteeringTerm.OFFSET, SteeringTerm.DEAD_ZONE)
    return tuple(term for term in terms if term in kept)


def _solve(terms: tuple[SteeringTerm, ...], turns: _SteadyTurns) -> _Solved:
    """One regression; with a dead zone on the samples beyond it, whose width follows from the solution."""
    rows = np.ones(len(turns.samples.block), dtype=bool)
    zone_rad = START_ZONE_RAD if SteeringTerm.DEAD_ZONE in terms else 0.0
    for _ in range(ZONE_ROUNDS if zone_rad else 1):
        if zone_rad:
            angle = turns.base.steer_ratio * turns.base.length_m * turns.geometry.curvature_1pm
            rows = np.abs(angle) > CRITERIA.dead_zone_spans * zone_rad
        solved = _regress(terms, turns, rows)
        zone_rad = min(max(solved.value.dead_zone_rad, CRITERIA.min_dead_zone_rad), CRITERIA.max_dead_zone_rad)
        zone_rad = zone_rad if SteeringTerm.DEAD_ZONE in terms else 0.0
    return solved


def _regress(terms: tuple[SteeringTerm, ...], turns: _SteadyTurns, rows: Array) -> _Solved:
    """The regression of the wheel angle on these terms and on slow changes of the turn.

    Args:
        rows: The samples to use, bool (n_samples,).
    """
    samples, geometry, coverage, base = turns
    samples = samples.select(rows)
    kappa, lateral = geometry.curvature_1pm[rows], geometry.lateral_mps2[rows]
    columns = {
        SteeringTerm.RATIO: base.length_m * kappa,
        SteeringTerm.OFFSET: np.ones(len(kappa)),
        SteeringTerm.DEAD_ZONE: np.sign(kappa),
        SteeringTerm.LENGTH_CUBIC: _cubic(kappa, coverage.curvature_1pm),
        SteeringTerm.UNDERSTEER: lateral,
        SteeringTerm.UNDERSTEER_CUBIC: _cubic(lateral, coverage.lateral_accel_mps2),
    }
    known = np.zeros(len(kappa))  # road-wheel angle of the terms that keep their value
    if SteeringTerm.LENGTH_CUBIC not in terms:
        known += base.length_cubic_m3 * _cubic(kappa, base.curvature_bound_1pm)
    if SteeringTerm.UNDERSTEER not in terms:
        known += base.understeer_s2pm * lateral
    target = samples.wheel_rad.copy()
    if SteeringTerm.OFFSET not in terms:
        target -= base.offset_rad
    if SteeringTerm.RATIO in terms:
        columns[SteeringTerm.RATIO] = columns[SteeringTerm.RATIO] + known
    else:
        target -= base.steer_ratio * (base.length_m * kappa + known)
    change, v = samples.yaw_accel_radps2, samples.speed_mps
    changing = [change / v, change, change * v]
    matrix = np.stack([*(columns[term] for term in terms), *changing], axis=1)
    regression = fit_blocks(matrix, target, samples.block, NOISE_FLOOR_RAD)
    value = _map_of(terms, regression.solution, base)
    replicates = tuple(_map_of(terms, row, base) for row in regression.without_block)
    return _Solved(terms, regression, value, replicates)


def _map_of(terms: Sequence[SteeringTerm], solution: Array, base: SteeringMap) -> SteeringMap:
    """The map of a solution: what multiplies road-wheel angles is divided by the ratio."""
    numbers = dict(zip(terms, (float(number) for number in solution), strict=False))
    ratio = numbers.get(SteeringTerm.RATIO, base.steer_ratio)
    in_wheel = (SteeringTerm.RATIO, SteeringTerm.OFFSET, SteeringTerm.DEAD_ZONE)
    fields = {term.value: number if term in in_wheel else number / ratio for term, number in numbers.items()}
    return base._replace(**fields)


def _cubic(values: Array, bound: float) -> Array:
    """x^3 up to |x| = bound, then straight on, as `odd_cubic` does."""
    inside = np.clip(values, -bound, bound)
    return inside**3 + 3.0 * inside * inside * (values - inside)


class _WeakTerm(NamedTuple):
    """A term that is not worth its place, and why."""

    term: SteeringTerm
    reason: str


def _weakest(solved: _Solved, base: SteeringMap) -> _WeakTerm | None:
    """The term to drop next: one that differs least from what is assumed, then one that the data leave open."""
    halves = {term: _half_width(solved.replicates, term.value) for term in solved.terms}
    optional = [term for term in OPTIONAL if term in solved.terms]
    steps = {term: abs(getattr(solved.value, term.value) - getattr(base, term.value)) for term in optional}
    insignificant = [term for term in optional if steps[term] <= halves[term] or _is_no_dead_zone(term, solved.value)]
    if insignificant:
        term = min(insignificant, key=lambda term: steps[term] / max(halves[term], 1e-12))
        return _WeakTerm(term, "the data show no difference from it")
    limits = {
        SteeringTerm.UNDERSTEER: CRITERIA.max_slip_half_width_s2pm,
        SteeringTerm.RATIO: CRITERIA.max_ratio_half_width * abs(solved.value.steer_ratio),
        SteeringTerm.OFFSET: CRITERIA.max_offset_half_width_rad,
    }
    if not solved.regression.is_determined:
        return _WeakTerm((*optional, *(term for term in limits if term in solved.terms))[0], "the data cannot tell it")
    for term, limit in limits.items():
        if term in solved.terms and not halves[term] <= limit:
            return _WeakTerm(term, f"the data leave it open by {halves[term]:.2g} to either side")
    return None


def _is_no_dead_zone(term: SteeringTerm, value: SteeringMap) -> bool:
    """Whether a fitted dead zone is none: negative, within the report's resolution, or another steering."""
    in_range = CRITERIA.min_dead_zone_rad <= value.dead_zone_rad <= CRITERIA.max_dead_zone_rad
    return term is SteeringTerm.DEAD_ZONE and not in_range


def _half_width(replicates: Sequence[SteeringMap], name: str) -> float:
    """Half of the 95 % interval: the blocks' spread, and what blocks have in common."""
    values = np.array([getattr(steering, name) for steering in replicates])
    is_cubic = name in (SteeringTerm.LENGTH_CUBIC.value, SteeringTerm.UNDERSTEER_CUBIC.value)
    share = CRITERIA.systematic_cubic_share if is_cubic else CRITERIA.systematic_share
    return math.hypot(float(jackknife_half_width(values)), share * float(np.abs(values).mean()))


def _with_bounds(steering: SteeringMap, bounds: SteeringMap) -> SteeringMap:
    return steering._replace(
        curvature_bound_1pm=bounds.curvature_bound_1pm, lateral_accel_bound_mps2=bounds.lateral_accel_bound_mps2
    )


def _estimate_term(steering: SteeringMap, replicates: Sequence[SteeringMap], term: SteeringTerm) -> Estimate:
    """A fitted coefficient with its interval."""
    value, half = getattr(steering, term.value), _half_width(replicates, term.value)
    return Estimate(value, value - half, value + half)


def _list_estimates(
    steering: SteeringMap,
    fitted: Mapping[SteeringTerm, Estimate],
    reasons: Mapping[SteeringTerm, str],
    base_label: str,
) -> dict[str, Estimate]:
    """The coefficients with intervals or reasons, in the order of SteeringMap."""
    by_name = {term.value: estimate for term, estimate in fitted.items()}
    why = {term.value: f"{base_label}: {reason}" for term, reason in reasons.items()} | NEVER_FITTED
    return {
        name: by_name.get(name) or Estimate(value, value, value, False, why.get(name, base_label))
        for name, value in steering._asdict().items()
        if name not in BOUNDS
    }
