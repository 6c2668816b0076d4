"""Who else may be meant where one effect counts as a name.

Rivals that the blocks do not tell from it are named with it, as a set; nothing is decided by order.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tunefree_hil.gap.estimation.evidence import LEAST_NATS, holm, paired
from tunefree_hil.gap.selection.criteria import PLAIN_NATS, Weighed

Array = np.ndarray

SAME = 0.25  # of what the best takes off its target's error: who takes less is asked about something else
CLOSE = 0.03  # of what the best gains: a rival as near as that is too near for a model that is not exact


def outdone(weighed: Sequence[Weighed]) -> str:
    """Who has more evidence than the best that counts, and does not count itself: then nobody is to be named. Whose
    blocks are not at one about that must explain more of what was held out as well; who explains another signal says
    nothing about the best.
    """
    best = weighed[0]
    beyond = [
        one
        for one in weighed[1:]
        if not one.counts and one.matters and one.evidence > best.evidence + LEAST_NATS and _of_the_same(one, best)
    ]
    better = [one for one in beyond if one.gain.low > 0.0 or one.gain.total > best.gain.total + LEAST_NATS]
    return max(better, key=lambda one: one.evidence).name if better else ""


def rivals(weighed: Sequence[Weighed], blocks: Array) -> list[str]:
    """Names that the best cannot be told from: those which its blocks do not beat, all of them asked at once, and which
    explain what it does: who is about another signal is found beside it, and not in its place. Where no
    link is broken also those which explain as much of the same and are behind by no more than any mismatch is worth.
    Of all suspects by themselves also those which explain more of the same, on no less evidence: the rule for names
    that they fail does not make the best one true.
    """
    best = weighed[0]
    others = [one for one in weighed[1:] if one.nearly and _of_the_same(one, best)]
    pairs = {one.name: paired(best.model.fitted, one.model.fitted, blocks) for one in others}
    beaten = holm({name: pair.doubt for name, pair in pairs.items()})
    near = CLOSE * max(best.gain.total, 0.0)
    equal = {one.name for one in others if best.unbroken and _is_equal(one, best)}
    untold = [
        name
        for name, pair in pairs.items()
        if name not in beaten or pair.total < max(LEAST_NATS, near) or name in equal
    ]
    return untold + [one.name for one in weighed[1:] if one.name not in pairs and _is_more(one, best)]


def _of_the_same(one: Weighed, best: Weighed) -> bool:
    """Whether it takes off the best one's target what the best does, or a good part of that."""
    return best.target not in one.shrinks or one.shrinks[best.target] > SAME * best.shrink[0]


def _is_equal(one: Weighed, best: Weighed) -> bool:
    """Whether it explains as much of the same target, with hardly less evidence."""
    as_much = one.target == best.target and one.shrink[0] > (1.0 - CLOSE) * best.shrink[0]
    return as_much and best.evidence - one.evidence < PLAIN_NATS


def _is_more(one: Weighed, best: Weighed) -> bool:
    """Whether it explains more of the same target, on no less evidence, beside nobody else."""
    as_sure = one.matters and not best.further and one.evidence >= best.evidence
    return as_sure and one.target == best.target and one.shrink[0] > best.shrink[0]
