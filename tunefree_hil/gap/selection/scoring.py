"""Scores of candidate effects, from models that are fitted already."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.diagnostics.lack_of_fit import LackOfFit
from tunefree_hil.gap.estimation.evidence import (
    compare_paired,
    correlation_rows_by_target,
    log_evidence,
    predictive_log_likelihood,
    with_correlation_rows,
)
from tunefree_hil.gap.estimation.intervals import distance_to_neutral
from tunefree_hil.gap.estimation.least_squares import Fit
from tunefree_hil.gap.selection.criteria import CRITERIA, CandidateScore, Reduction
from tunefree_hil.gap.workers.worker import FitSummary

Array = np.ndarray

N_DRAWS = 1000  # bootstrap draws of whole blocks


class Comparison(NamedTuple):
    """What candidates are scored against.

    Args:
        base: the model that they are added to.
        recalibrated: the model without effects; error reductions are shares of its error.
        signal_scales: by target, the deviation of the signal.
        blocks: the blocks that count.
        broken: targets that recalibration alone leaves broken; None where that was not looked at.
        within_baseline: those of them that the model misses on its calibration logs too.
    """

    base: FitSummary
    recalibrated: FitSummary
    signal_scales: Mapping[str, float]
    blocks: Array
    broken: Collection[str] | None = None
    within_baseline: Collection[str] = ()


def score_candidates(candidates: Mapping[str, FitSummary], against: Comparison) -> list[CandidateScore]:
    """Score fitted candidates: the accepted ones first, in each part the one with the most evidence first.

    All are scored by the noise of the best candidate; which one is the best is decided by each candidate's own noise.
    With the noise of the base, a bias would hide its cause, as it is the same in every row. For a target that another
    candidate explains much better, that one's noise counts.
    """
    if not candidates:
        return []
    blocks, base = against.blocks, against.base

    def evidence_over_base(model: FitSummary) -> float:
        """Nats over the base, both by the noise that this model leaves."""
        compared = with_correlation_rows(base.fit, correlation_rows_by_target(model.fit))
        return log_evidence(model.fit, blocks) - log_evidence(compared, blocks)

    best = max(candidates, key=lambda name: evidence_over_base(candidates[name]))
    rows = _noise_rows(candidates, best, blocks)
    against = against._replace(base=base._replace(fit=with_correlation_rows(base.fit, rows)))
    scores = [
        _score_candidate(
            name,
            affected_targets(model, blocks, name),
            model._replace(fit=with_correlation_rows(model.fit, rows)),
            against,
        )
        for name, model in candidates.items()
    ]
    return sorted(scores, key=lambda score: (not score.is_accepted, -score.evidence))


def _score_candidate(name: str, affected: Sequence[str], model: FitSummary, against: Comparison) -> CandidateScore:
    """Score one candidate by the same noise as its base. affected: targets that it moves, by its own noise."""
    blocks, base, recalibrated = against.blocks, against.base, against.recalibrated
    fit, base_fit, broken = model.fit, base.fit, against.broken
    gains = {target: _predictive_gain(fit, base_fit, blocks, target) for target in fit.equations}
    reductions = {target: error_reduction(base, model, target, blocks, recalibrated) for target in fit.equations}
    explained = {
        target: _explained_share(base, model, target, against) for target in dict.fromkeys((*affected, *gains))
    }
    relevant = [
        target
        for target in affected
        if gains[target] > CRITERIA.min_evidence_nats and explained[target] > CRITERIA.min_explained_share
    ]
    if relevant:
        target = max(relevant, key=lambda target: reductions[target].low)
    else:
        target = max(affected or gains, key=lambda target: gains[target])
    growth = _counted_growth(model, affected, gains, explained[target], against)
    return CandidateScore(
        name=name,
        model=model,
        evidence=log_evidence(fit, blocks) - log_evidence(base_fit, blocks),
        gain=compare_paired(fit, base_fit, blocks),
        target=target,
        error_reduction=reductions[target],
        degradation=max(growth.values(), default=0.0),
        is_relevant=bool(affected) and explained[target] > CRITERIA.min_explained_share,
        is_further=bool(base_fit.free),
        other_blocks_reduction=reduction_in_other_blocks(base, model, target, blocks, recalibrated),
        is_unbroken=broken is not None and target not in broken,
        broken_degradation=max(
            (share for key, share in growth.items() if broken is None or key in broken), default=0.0
        ),
        error_reductions={target: reduction.value for target, reduction in reductions.items()},
        explained_share=explained[target],
    )


def _counted_growth(
    model: FitSummary,
    affected: Sequence[str],
    gains: Mapping[str, float],
    explained: float,
    against: Comparison,
) -> dict[str, float]:
    """By how much the mean square of affected targets grows, as a share, as far as that counts against a candidate.

    Growth does not count below a share of what the candidate explains, or up to `max_baseline_degradation` where the
    model misses the target on its calibration logs too, or where the target's link is not broken and its predictive
    gain is not negative.

    Args:
        gains: by target, predictive log likelihood over the base.
        explained: share of its own signal that the candidate explains.
    """
    least = max(CRITERIA.min_explained_share, CRITERIA.min_degradation_share * explained)
    growth = {
        target: _growth(against.base, model, target, against.blocks)
        for target in affected
        if _explained_share(model, against.base, target, against) > least
    }
    broken, within, limit = against.broken, against.within_baseline, CRITERIA.max_baseline_degradation
    return {
        target: share
        for target, share in growth.items()
        if (target not in within or share > limit) and (broken is None or target in broken or gains[target] < 0.0)
    }


def _predictive_gain(fit: Fit, base: Fit, blocks: Array, target: str) -> float:
    """Cross-validated log likelihood of a target, over the base's."""
    likelihoods, base_likelihoods = (predictive_log_likelihood(model, blocks, [target]) for model in (fit, base))
    return float((likelihoods - base_likelihoods).sum())


def _noise_rows(candidates: Mapping[str, FitSummary], best: str, blocks: Array) -> dict[str, float]:
    """Rows over which residuals are correlated, by target: the best candidate's, or that of a candidate that misses
    less than half of what the best one misses.
    """
    rows = correlation_rows_by_target(candidates[best].fit)
    for target in rows:
        errors = {name: _mean_square(model, target, blocks) for name, model in candidates.items()}
        least = min(errors, key=lambda name: errors[name])
        if errors[least] < CRITERIA.noise_source_share**2 * errors[best]:
            rows[target] = min(rows[target], correlation_rows_by_target(candidates[least].fit)[target])
    return rows


def affected_targets(model: FitSummary, blocks: Array, name: str = "") -> list[str]:
    """Targets that a model's effects, or the one of that name, move in these blocks by more than their noise.

    What recalibration takes from other targets, or adds to them, beside an effect does not count for the effect.
    """
    fit = model.fit
    own_keys = range(len(fit.keys) - len(fit.free), len(fit.keys))  # the effects' parameters are the last keys
    moves = {
        i: distance_to_neutral(free, float(fit.z[i]))
        for i, free in zip(own_keys, fit.free, strict=True)
        if not name or free.key.partition(".")[0] == name
    }
    affected = []
    for target, equations in fit.equations.items():
        curvature = np.einsum("bii->i", equations.curvature[blocks]) / equations.noise.correlation_rows
        squares = [curvature[c] * moves[int(i)] ** 2 for c, i in enumerate(equations.columns) if int(i) in moves]
        if max(squares, default=0.0) > CRITERIA.min_affected_squares:
            affected.append(target)
    return affected


def _growth(before: FitSummary, after: FitSummary, target: str, blocks: Array) -> float:
    """By how much a target's mean square grows, row by row, as a share."""
    squares = [float(model.squared_residuals[target][0][blocks].sum()) for model in (before, after)]
    return squares[1] / squares[0] - 1.0 if squares[0] > 0.0 else 0.0


def _explained_share(before: FitSummary, after: FitSummary, target: str, against: Comparison) -> float:
    """RMS that a model takes off another one's error of a target, as a share of the signal."""
    less = _mean_square(before, target, against.blocks) - _mean_square(after, target, against.blocks)
    return max(less, 0.0) ** 0.5 / max(against.signal_scales[target], 1e-12)


def _mean_square(model: FitSummary, target: str, blocks: Array) -> float:
    sums, counts = model.squared_residuals[target]
    return float(sums[blocks].sum() / max(counts[blocks].sum(), 1.0))


def error_reduction(
    before: FitSummary,
    after: FitSummary,
    target: str,
    blocks: Array,
    recalibrated: FitSummary | None = None,
) -> Reduction:
    """By how much a target's RMS error shrinks, as a share of the recalibrated one's (None: of `before`'s), with its
    95 % interval over blocks; row by row or by means over a second, whichever has the higher lower bound.

    A noisy sensor's error from row to row is in no model; what a car drifts by within a block is in the means.
    """
    models = (before, after, before if recalibrated is None else recalibrated)
    views = [bootstrap_reduction([model.squared_residuals[target] for model in models], blocks)]
    if target in before.averaged_squared_residuals:
        views.append(bootstrap_reduction([model.averaged_squared_residuals[target] for model in models], blocks))
    return max(views, key=lambda view: view.low)


def reduction_in_other_blocks(
    before: FitSummary, after: FitSummary, target: str, blocks: Array, recalibrated: FitSummary
) -> float:
    """By how much a target's RMS error shrinks, row by row, in all blocks but the one that gains most."""
    squares = [model.squared_residuals[target][0][blocks] for model in (before, after, recalibrated)]
    rest = np.arange(len(blocks)) != int(np.argmax(squares[0] - squares[1]))
    rms = [float(np.sqrt(by_block[rest].sum())) for by_block in squares]
    return (rms[0] - rms[1]) / rms[2] if rms[2] > 0.0 else 0.0


def bootstrap_reduction(squares: Sequence[tuple[Array, Array]], blocks: Array, seed: int = 1) -> Reduction:
    """The share by which an RMS error shrinks.

    Args:
        squares: sums and counts by block: before, after, and of the error that it is a share of.
    """
    sums = np.stack([total[blocks] for total, _ in squares])
    if sums[2].sum() <= 0.0:
        return Reduction(0.0, 0.0, 0.0)
    drawn = np.random.default_rng(seed).integers(0, len(blocks), (N_DRAWS, len(blocks)))
    before, after, whole = np.sqrt(np.column_stack([sums.sum(axis=1), sums[:, drawn].sum(axis=2)]))
    shares = (before - after) / np.maximum(whole, 1e-150)
    low, high = np.quantile(shares[1:], [0.025, 0.975])
    return Reduction(float(shares[0]), float(low), float(high))


def explained_targets(
    recalibrated: FitSummary, repaired: FitSummary, signal_scales: Mapping[str, float], blocks: Array
) -> dict[str, float]:
    """The targets that a model's effects explain, each with the share of its signal that they explain.

    A target has to be affected and its error to shrink: beside an effect, recalibration moves any target a little.
    """
    against = Comparison(recalibrated, recalibrated, signal_scales, blocks)
    shares = {
        target: _explained_share(recalibrated, repaired, target, against)
        for target in affected_targets(repaired, blocks)
        if target in signal_scales
    }
    return {
        target: share
        for target, share in shares.items()
        if share > CRITERIA.min_explained_share
        and error_reduction(recalibrated, repaired, target, blocks).value >= CRITERIA.min_error_reduction
    }


def unexplained_share(before: LackOfFit, after: LackOfFit) -> float:
    """Share of a target's explainable mean square that is left."""
    return max(after.explained, 0.0) / before.explained if before.explained > 0.0 else 0.0
