"""When a name is given, when several, and when none: the rules, on models that are fitted already.

A name needs evidence and the blocks' agreement, and must make a difference that matters: numbers alone make anything
significant. Who else may be meant where one counts: gap/selection/equivalence.py.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.diagnostics.lack_of_fit import Left
from tunefree_hil.gap.estimation.evidence import (
    LEAST_NATS,
    Paired,
    log_evidence,
    paired,
    predictive,
    stretched,
    stretches,
)
from tunefree_hil.gap.estimation.intervals import distance
from tunefree_hil.gap.workers.worker import Modelled

Array = np.ndarray

LEAST_SHRINK = 0.05  # of a target's error without any effect: less is no gap that anybody would repair
FURTHER_SHRINK = 0.1  # of that as well, by a further effect: what the first one's form misses of its cause is none
PLAIN = 0.4  # of that, where no link is broken: who is missing explains most of what is missed, a mismatch a part
PLAIN_NATS = 60.0  # of evidence: more is no mismatch's, by what cars without any effect came to
SURE = 0.5  # with the doubt between blocks: at least half of that
MATTERS = 0.004  # of the signal: what an effect explains there, root mean square; less is nobody's worry
MOST_WORSE = 0.05  # of any target's: what explains one thing by spoiling another explains nothing
NEARLY_ALL, SPARED = 0.9, 0.2  # of a target surely explained: then it may be so much, of another that hardly is missed
MAY_GROW = 0.5  # of a target's mean square, where the model misses it as usual: its form is off, whoever is beside it
SPOILT = 0.1  # of what is explained, each by its signal: recalibration trades so much between signals by itself
HALF = 0.5  # of a target's error: who misses less than that of what the best misses there knows its noise better
MOST_LEFT = 0.25  # of what could be explained of a target before: more, and the name was not it
BY_A_HAIR = 0.8  # of every bar: who misses none by more is no name, but a name's rival
RARE = 0.3  # of that, without the block that gains most: what two blocks hold clearly is no chance
ALL_OF_IT = 0.95  # of a broken target's error: what one block alone holds, and explains so well, is no chance either
FELT = 1.0  # squares, all blocks together, that an effect moves by itself: less is nothing that a target feels
NOISY = 3.0  # standard deviations between blocks: a further effect that gains less is the noise of the first one's fit

NO_NUMBERS: Mapping[str, float] = {}


class Weighed(NamedTuple):
    """A candidate against the model that it is added to. evidence: nats. target: where it gains most clearly; shrink:
    by how much the error there gets less, as a share of what it is without any effect, (value, low, high); rest: the
    same of all blocks but the one that gains most. worst: by how much the mean square grows where it grows most, as a
    share; worst_missed: the same of targets that are broken as it is. further: beside some. unbroken: recalibration
    alone misses no more of the target than a model may.

    others: names that explain as much in its place; known once a search is done (search.py). placed: evidence of all
    who were asked there, itself among them. shrinks: by target, what `shrink` is of its own; empty where nobody asked.
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
    rest: float = 0.0
    others: tuple[str, ...] = ()
    placed: Mapping[str, float] = NO_NUMBERS
    unbroken: bool = False
    worst_missed: float = 0.0
    shrinks: Mapping[str, float] = NO_NUMBERS

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

    @property
    def faint(self) -> bool:
        """Whether nothing but the name itself says that anything is missing, and that not plainly: any mismatch of a
        model has somebody who explains a part of it, and little evidence. Only a proof can bear such a name out.
        """
        return self.unbroken and self.shrink[0] < PLAIN and self.evidence < PLAIN_NATS

    @property
    def spoils(self) -> bool:
        """Whether it is plainly there and kept from being a name by what it makes worse alone: so are two that hide
        each other, each beside the model without the other.
        """
        plain = self.evidence > PLAIN_NATS and self.shrink[0] > PLAIN
        return plain and not self.counts and self._replace(worst=0.0, worst_missed=0.0).counts

    @property
    def _all_of_it(self) -> bool:
        """Whether it explains all that is missed where a link is broken: of a stop that one manoeuvre reaches nobody
        else comes near to that.
        """
        return not self.unbroken and self.shrink[0] > ALL_OF_IT

    def _passes(self, bar: float) -> bool:
        """Whether it is above all bars, each taken so many times."""
        least, shrink = bar * LEAST_NATS, FURTHER_SHRINK if self.further else LEAST_SHRINK
        if self.further and self.unbroken:
            shrink = PLAIN
        plain = bar * PLAIN_NATS if self.further else least  # beside a first one any mismatch has somebody, as in faint
        sure = self.evidence > plain and self.gain.total > least and self.gain.low > 0.0
        if self.further and not self._all_of_it:
            sure = sure and self.gain.total > bar * NOISY * self.gain.noise
        return (
            sure
            and self.matters
            and self.shrink[0] > bar * shrink
            and (self.shrink[1] > bar * SURE * shrink or self.rest > bar * RARE or self._all_of_it)
            and self.worst < (SPARED if self.shrink[1] > NEARLY_ALL else MOST_WORSE) / bar
            and self.worst_missed < MOST_WORSE / bar
        )


def weigh(
    candidates: Mapping[str, Modelled], start: Modelled, null: Modelled, sizes: Mapping[str, float], blocks: Array,
    broken: Collection[str] | None = None, usually: Collection[str] = (),
) -> list[Weighed]:  # fmt: skip
    """All candidates, the best first; by the noise that the best of them leaves. sizes: of each target's signal;
    broken: targets that recalibration alone leaves broken (locate.look); None: nobody has looked. usually: those of
    them that the model misses of its own logs as well: they speak against nobody who makes them a little worse.

    Who is the best is asked by the noise of each, and of start by the same: the noise's own logarithm counts once for
    every row that stands for itself, and where that number differs the unit of a signal would decide. By the noise of
    `start` alone a bias would hide who takes it away: its rows all say the same, as one. So would that of the best in a
    target which is another one's: there it is by the noise of whoever explains most of it.
    """
    if not candidates:
        return []

    def over_start(one: Modelled) -> float:
        """Nats over the start, both by the noise that this one leaves."""
        base = stretched(start.fitted, stretches(one.fitted))
        return log_evidence(one.fitted, blocks) - log_evidence(base, blocks)

    by = _noise_of(candidates, max(candidates, key=lambda name: over_start(candidates[name])), blocks)
    base = start._replace(fitted=stretched(start.fitted, by))
    found = [
        _weighed(
            name, felt(one, blocks, name), one._replace(fitted=stretched(one.fitted, by)), base, null, sizes, blocks,
            broken, usually,
        )
        for name, one in candidates.items()
    ]  # fmt: skip
    return sorted(found, key=lambda one: (not one.counts, -one.evidence))


def _weighed(
    name: str, own: Sequence[str], one: Modelled, start: Modelled, null: Modelled, sizes: Mapping[str, float],
    blocks: Array, broken: Collection[str] | None, usually: Collection[str],
) -> Weighed:  # fmt: skip
    """A candidate and what it is added to, both by the same noise. own: targets that feel it (by its own)."""
    model, base = one.fitted, start.fitted
    gains = {t: float((predictive(model, blocks, [t]) - predictive(base, blocks, [t])).sum()) for t in model.sums}
    shrinks = {t: shrink(start, one, t, blocks, null) for t in model.sums}
    worth = [t for t in own if gains[t] > LEAST_NATS and _explained(start, one, t, sizes, blocks) > MATTERS]
    target = max(worth, key=lambda t: shrinks[t][1]) if worth else max(own or gains, key=lambda t: gains[t])
    explained = _explained(start, one, target, sizes, blocks)
    worse = _worse(one, start, own, max(MATTERS, SPOILT * explained), sizes, blocks)
    worse = {t: grown for t, grown in worse.items() if t not in usually or grown > MAY_GROW}
    worse = {t: grown for t, grown in worse.items() if broken is None or t in broken or gains[t] < 0.0}
    return Weighed(
        name, one, log_evidence(model, blocks) - log_evidence(base, blocks), paired(model, base, blocks),
        target, shrinks[target], max(worse.values(), default=0.0), bool(own) and explained > MATTERS,
        bool(base.free), shrink_of_the_rest(start, one, target, blocks, null),
        unbroken=broken is not None and target not in broken,
        worst_missed=max((grown for t, grown in worse.items() if broken is None or t in broken), default=0.0),
        shrinks={t: value for t, (value, _, _) in shrinks.items()},
    )  # fmt: skip


def _worse(
    one: Modelled, start: Modelled, own: Sequence[str], least: float, sizes: Mapping[str, float], blocks: Array
) -> dict[str, float]:
    """Of the targets that it feels those of which it misses more than the start, by more than `least` of the signal:
    by how much their mean square grows.
    """
    return {t: _grown(start, one, t, blocks) for t in own if _explained(one, start, t, sizes, blocks) > least}


def _noise_of(candidates: Mapping[str, Modelled], best: str, blocks: Array) -> dict[str, float]:
    """How much residuals hang together, by target: of the best, or of who misses less than half of what that misses."""
    by = stretches(candidates[best].fitted)
    for target in by:
        least = min(candidates, key=lambda name: _mean_square(candidates[name], target, blocks))
        if _mean_square(candidates[least], target, blocks) < HALF**2 * _mean_square(candidates[best], target, blocks):
            by[target] = min(by[target], stretches(candidates[least].fitted)[target])
    return by


def felt(model: Modelled, blocks: Array, name: str = "") -> list[str]:
    """Targets that feel, in these blocks, a model's effects, or the one of that name. What recalibration, coming to
    rest elsewhere beside an effect, takes from the others or gives them is no merit of the effect and no fault.
    """
    fitted = model.fitted
    behind = range(len(fitted.keys) - len(fitted.free), len(fitted.keys))  # own parameters are the last keys
    own = [
        (i, one) for i, one in zip(behind, fitted.free, strict=True) if not name or one.key.partition(".")[0] == name
    ]
    way = {i: distance(one, float(fitted.z[i])) for i, one in own}
    found = []
    for target, one in fitted.sums.items():
        curve = np.einsum("bii->i", one.curve[blocks]) / one.colour.stretch
        moved = [curve[c] * way[int(i)] ** 2 for c, i in enumerate(one.columns) if int(i) in way]
        if max(moved, default=0.0) > FELT:
            found.append(target)
    return found


def _grown(before: Modelled, after: Modelled, target: str, blocks: Array) -> float:
    """By how much a target's mean square grows, tick by tick, as a share of what it is."""
    was, now = (float(one.squares[target][0][blocks].sum()) for one in (before, after))
    return now / was - 1.0 if was > 0.0 else 0.0


def _explained(before: Modelled, after: Modelled, target: str, sizes: Mapping[str, float], blocks: Array) -> float:
    """What a model takes off another one's misses of a target, root mean square, as a share of the signal."""
    less = _mean_square(before, target, blocks) - _mean_square(after, target, blocks)
    return max(less, 0.0) ** 0.5 / max(sizes[target], 1e-12)


def _mean_square(model: Modelled, target: str, blocks: Array) -> float:
    sums, counts = model.squares[target]
    return float(sums[blocks].sum() / max(counts[blocks].sum(), 1.0))


def shrink(
    before: Modelled, after: Modelled, target: str, blocks: Array, null: Modelled | None = None, seed: int = 1
) -> tuple[float, float, float]:
    """By how much a target's error shrinks (root mean square), as a share of the null's (else of `before`'s), with its
    95 % interval over blocks: tick by tick or of means over a second, whichever is surer. Most of what a noisy sensor
    misses from tick to tick no model takes away, and what a car goes astray by within a block is in the means.
    """
    some = (before, after, before if null is None else null)
    views = [shrunk([one.squares[target] for one in some], blocks, seed)]
    if target in before.slow:
        views.append(shrunk([one.slow[target] for one in some], blocks, seed))
    return max(views, key=lambda one: one[1])


def shrink_of_the_rest(before: Modelled, after: Modelled, target: str, blocks: Array, null: Modelled) -> float:
    """By how much a target's error shrinks, tick by tick, in all blocks but the one that gains most."""
    was, now, whole = (one.squares[target][0][blocks] for one in (before, after, null))
    rest = np.arange(len(blocks)) != int(np.argmax(was - now))
    left = [float(np.sqrt(one[rest].sum())) for one in (was, now, whole)]
    return (left[0] - left[1]) / left[2] if left[2] > 0.0 else 0.0


def shrunk(some: Sequence[tuple[Array, Array]], blocks: Array, seed: int = 1) -> tuple[float, float, float]:
    """(value, low, high) of one view. some: sums and counts by block, before, after, and of what it is a share."""
    sums = np.stack([sums[blocks] for sums, _ in some])
    if sums[2].sum() <= 0.0:
        return 0.0, 0.0, 0.0
    drawn = np.random.default_rng(seed).integers(0, len(blocks), (1000, len(blocks)))
    before, after, whole = np.sqrt(np.column_stack([sums.sum(axis=1), sums[:, drawn].sum(axis=2)]))
    shares = (before - after) / np.maximum(whole, 1e-150)
    low, high = np.quantile(shares[1:], [0.025, 0.975])
    return float(shares[0]), float(low), float(high)


def worked_on(null: Modelled, repaired: Modelled, sizes: Mapping[str, float], blocks: Array) -> dict[str, float]:
    """The targets of which effects explain what matters, and how much of each signal: there they are answerable for
    what is left. They have to feel the effects, and to be missed by LEAST_SHRINK less: recalibration that comes to
    rest elsewhere beside an effect takes a little from any target or gives it.
    """
    explained = {
        name: _explained(null, repaired, name, sizes, blocks) for name in felt(repaired, blocks) if name in sizes
    }
    return {
        name: share
        for name, share in explained.items()
        if share > MATTERS and shrink(null, repaired, name, blocks)[0] >= LEAST_SHRINK
    }


def left_share(before: Left, after: Left) -> float:
    """Of what anything could have explained of a target, the part that still can be."""
    return max(after.explained, 0.0) / before.explained if before.explained > 0.0 else 0.0
