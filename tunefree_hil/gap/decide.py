"""When a name is given, when several, and when none: the rules, on models that are fitted already.

A name needs evidence and the blocks' agreement, and must make a difference that matters: numbers alone make anything
significant. Rivals that the blocks do not tell from it are named with it, as a set; nothing is decided by order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.ask import Modelled
from tunefree_hil.gap.evidence import (
    LEAST_NATS,
    Paired,
    holm,
    log_evidence,
    paired,
    predictive,
    stretched,
    stretches,
)
from tunefree_hil.gap.leftover import Left

Array = np.ndarray

LEAST_SHRINK = 0.05  # of a target's mean square without any effect: less is no gap that anybody would repair
SURE_SHRINK = 0.025  # with the doubt between blocks: at least half of that
MATTERS = 0.004  # of the signal: what an effect explains there, root mean square; less is nobody's worry
MOST_WORSE = 0.05  # of any target's: what explains one thing by spoiling another explains nothing
SPOILT = 0.1  # of what is explained, each by its signal: recalibration trades so much between signals by itself
CLOSE = 0.03  # of what the best gains: a rival as near as that is too near for a model that is not exact
MOST_LEFT = 0.35  # of what could be explained before: more, and the name was not it
BY_A_HAIR = 0.8  # of every bar: who misses none by more is no name, but a name's rival
NOISY = 3.0  # standard deviations between blocks: a further effect that gains less is the noise of the first one's fit


class Weighed(NamedTuple):
    """A candidate against the model that it is added to. evidence: nats. target: where it gains most clearly; shrink:
    by how much the mean square there gets less, as a share of what it is without any effect, (value, low, high).
    worst: by how much it grows where it grows most, as a share. further: beside some.

    others: names that explain as much in its place; known once a search is done (search.py).
    """

    name: str
    model: Modelled
    evidence: float
    gain: Paired
    target: str
    shrink: tuple[float, float, float]
    worst: float
    matters: bool
    further: bool = False
    others: tuple[str, ...] = ()

    @property
    def counts(self) -> bool:
        """Whether this is a name: evidence and blocks agree, and it matters, in more blocks than one: a noise that is
        the same for all of them makes of one block's gain a little in each.
        """
        return self._passes(1.0)

    @property
    def nearly(self) -> bool:
        """Whether it is a name, or misses being one by a hair: a set in which it is not would be too sure."""
        return self._passes(BY_A_HAIR)

    def _passes(self, bar: float) -> bool:
        """Whether it is above all bars, each taken so many times."""
        least = bar * LEAST_NATS
        sure = self.evidence > least and self.gain.total > least and self.gain.low > 0.0
        if self.further:
            sure = sure and self.gain.total > bar * NOISY * self.gain.noise
        return (
            sure
            and self.matters
            and self.shrink[0] > bar * LEAST_SHRINK
            and self.shrink[1] > bar * SURE_SHRINK
            and self.worst < MOST_WORSE / bar
        )


def weigh(
    candidates: Mapping[str, Modelled], start: Modelled, null: Modelled, sizes: Mapping[str, float], blocks: Array
) -> list[Weighed]:
    """All candidates, the best first; by the noise that the best of them leaves. sizes: of each target's signal.

    Who is the best is asked by the noise of `start`, one for all of them: the noise's own logarithm counts once for
    every row that stands for itself, and where that number differs the unit of a signal would decide.
    """
    if not candidates:
        return []
    own = stretches(start.fitted)
    best = max(candidates.values(), key=lambda one: log_evidence(stretched(one.fitted, own), blocks))
    by = stretches(best.fitted)
    base = stretched(start.fitted, by)
    before = log_evidence(base, blocks)
    found = []
    for name, one in candidates.items():
        model = stretched(one.fitted, by)
        gains = {t: float((predictive(model, blocks, [t]) - predictive(base, blocks, [t])).sum()) for t in model.sums}
        shrinks = {t: shrink(start, one, t, blocks, null) for t in model.sums}
        worth = [t for t in gains if gains[t] > LEAST_NATS and _explained(start, one, t, sizes, blocks) > MATTERS]
        target = max(worth, key=lambda t: shrinks[t][1]) if worth else max(gains, key=lambda t: gains[t])
        least = max(MATTERS, SPOILT * _explained(start, one, target, sizes, blocks))
        worse = [
            -shrink(start, one, t, blocks)[0] for t in model.sums if _explained(one, start, t, sizes, blocks) > least
        ]
        found.append(
            Weighed(
                name, one._replace(fitted=model), log_evidence(model, blocks) - before, paired(model, base, blocks),
                target, shrinks[target], max(worse, default=0.0),
                _explained(start, one, target, sizes, blocks) > MATTERS, bool(start.fitted.free),
            )
        )  # fmt: skip
    return sorted(found, key=lambda one: (not one.counts, -one.evidence))


def _explained(before: Modelled, after: Modelled, target: str, sizes: Mapping[str, float], blocks: Array) -> float:
    """What a model takes off another one's misses of a target, root mean square, as a share of the signal."""
    less = _mean_square(before, target, blocks) - _mean_square(after, target, blocks)
    return max(less, 0.0) ** 0.5 / max(sizes[target], 1e-12)


def _mean_square(model: Modelled, target: str, blocks: Array) -> float:
    sums, counts = model.squares[target]
    return float(sums[blocks].sum() / max(counts[blocks].sum(), 1.0))


def outdone(weighed: Sequence[Weighed]) -> str:
    """Who has more evidence than the best that counts, and does not count itself: then nobody is to be named."""
    best = weighed[0]
    beyond = [one for one in weighed[1:] if not one.counts and one.matters and one.gain.low > 0.0]
    better = [one for one in beyond if one.evidence > best.evidence + LEAST_NATS]
    return max(better, key=lambda one: one.evidence).name if better else ""


def shrink(
    before: Modelled, after: Modelled, target: str, blocks: Array, null: Modelled | None = None, seed: int = 1
) -> tuple[float, float, float]:
    """By how much a target's mean square shrinks, as a share of the null's (else of `before`'s), with its 95 %
    interval over blocks.
    """
    was, now = before.squares[target][0][blocks], after.squares[target][0][blocks]
    whole = was if null is None else null.squares[target][0][blocks]
    if whole.sum() <= 0.0:
        return 0.0, 0.0, 0.0
    chance = np.random.default_rng(seed)
    drawn = chance.integers(0, len(blocks), (1000, len(blocks)))
    some = (was - now)[drawn].sum(axis=1) / np.maximum(whole[drawn].sum(axis=1), 1e-300)
    low, high = np.quantile(some, [0.025, 0.975])
    return float((was - now).sum() / whole.sum()), float(low), float(high)


def rivals(weighed: Sequence[Weighed], blocks: Array) -> list[str]:
    """Names that the best cannot be told from: those which its blocks do not beat, all of them asked at once."""
    best, others = weighed[0], [one for one in weighed[1:] if one.nearly]
    pairs = {one.name: paired(best.model.fitted, one.model.fitted, blocks) for one in others}
    beaten = holm({name: pair.doubt for name, pair in pairs.items()})
    near = CLOSE * max(best.gain.total, 0.0)
    return [name for name, pair in pairs.items() if name not in beaten or pair.total < max(LEAST_NATS, near)]


def left_share(before: Mapping[str, Left], after: Mapping[str, Left]) -> float:
    """Of what anything could have explained, the part that still can be; each target by its noise."""
    was = now = 0.0
    for name, one in after.items():
        noise = max(one.total - one.explained, 1e-30)
        was += max(before[name].explained, 0.0) / noise
        now += max(one.explained, 0.0) / noise
    return now / was if was > 0.0 else 0.0
