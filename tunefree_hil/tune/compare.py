"""Is the tuned result better, and how sure is that? Plain functions, which tools/measure prints (design D9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.sampling import suggest
from tunefree_hil.tune.space import Space
from tunefree_hil.tune.study import Baseline, Evaluate, Trial

FEWEST_FOR_BOOTSTRAP = 5
RESAMPLES = 10_000
LEVEL = 0.95


class Spread(NamedTuple):
    """A median with its 95 % interval; min to max where n < 5 (interfaces 1)."""

    value: float
    low: float
    high: float
    n: int


class Standing(NamedTuple):
    """The best of the baselines. `replans`: over all its scenarios, to be said beside a comparison (interfaces 7)."""

    name: str
    score: float
    replans: int


def spread(values: Sequence[float], *, seed: int = 1) -> Spread:
    """Median and interval of independent values, such as one a study seed: percentile bootstrap of the median.

    Raises InputError when there are none, or one is not finite.
    """
    data = np.asarray(values, dtype=np.float64)
    if data.size == 0 or not np.all(np.isfinite(data)):
        raise InputError(f"no interval of {list(values)}", code="bad_values", hint="give one finite value or more")
    median = float(np.median(data))
    if data.size < FEWEST_FOR_BOOTSTRAP:
        return Spread(median, float(data.min()), float(data.max()), data.size)
    draws = np.random.default_rng(seed).integers(0, data.size, (RESAMPLES, data.size))
    tails = (0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))
    low, high = np.quantile(np.median(data[draws], axis=1), tails)
    return Spread(median, float(low), float(high), data.size)


def improvement(tuned: Sequence[float], manual: float | Sequence[float], *, seed: int = 1) -> Spread:
    """Ratio tuned / manual, below 1 when the tuned one is better: one ratio a study, paired where manual has many.

    Raises InputError where a manual score is not above 0 or the lengths differ.
    """
    against = [manual] * len(tuned) if isinstance(manual, (int, float)) else list(manual)
    if len(against) != len(tuned) or not all(score > 0.0 for score in against):
        raise InputError(
            f"no ratios of {len(tuned)} tuned and {len(against)} manual scores",
            code="bad_values",
            hint="give one manual score above 0, or one for each tuned score",
        )
    return spread([score / other for score, other in zip(tuned, against, strict=True)], seed=seed)


def best_baseline(baselines: Mapping[str, Baseline]) -> Standing:
    """The baseline of the lowest score, the first of equals. Raises InputError when there is none."""
    if not baselines:
        raise InputError("no baseline was scored", code="no_baseline", hint="score one with Study.add_baseline")
    name = min(baselines, key=lambda one: baselines[one].score)
    best = baselines[name]
    return Standing(name, best.score, sum(int(drive.get("replans", 0) or 0) for drive in best.scenarios.values()))


def best_so_far(scores: Sequence[float]) -> list[float]:
    """The lowest score up to and with each trial."""
    return [float(score) for score in np.minimum.accumulate(np.asarray(scores, dtype=np.float64))]


def random_search(
    space: Space, trials: int, evaluate: Evaluate, *, seed: int, first: Mapping[str, float]
) -> list[Trial]:
    """Random search at the same budget as a study and from the same first trial, in memory.

    It gives the trials of a study with sampler "random". What `evaluate` raises goes through.
    """
    found = []
    for slot in range(trials):
        values = suggest(space, [], sampler="random", seed=seed, slot=slot) if slot or not first else dict(first)
        evaluation = evaluate(dict(values))
        found.append(Trial(slot, slot, values, evaluation.score, evaluation.scenarios, evaluation.error))
    return found
