"""What an effect does to its own signal on blocks that prove, held against what it does on those that judged it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.selection.criteria import shrunk
from tunefree_hil.gap.workers.worker import Modelled

Array = np.ndarray

HARDLY = 0.1  # of the error on blocks that judged, root mean square: less is next to nothing beside what it is about


class Own(NamedTuple):
    """seen, unseen: by how much an effect shrinks a target's error on the blocks that judged it and on those that
    prove, as a share of the null's; NaN where those have nothing of the target. stirs: share of the null's squares by
    which it changes any block that proves, for better or worse: who stirs nothing is not shown there. Where the null
    misses hardly anything on them, shares are of HARDLY of what it misses elsewhere: a stop that they do not reach.
    """

    seen: float
    unseen: float
    stirs: float


NOT_LOOKED = Own(math.nan, math.nan, math.nan)


def own(before: Modelled, after: Modelled, null: Modelled, target: str, blocks: Array, proof: Array) -> Own:
    """Of the effect that `after` has and `before` has not. Tick by tick or by means of a second, whichever is surer on
    the blocks that judged (decide.shrink); on those that prove the same.
    """
    some = (before, after, null)
    views = [[one.squares[target] for one in some]]
    if target in before.slow:
        views.append([one.slow[target] for one in some])
    view = max(views, key=lambda one: shrunk(one, blocks)[1])
    was, now, whole = (sums[proof] for sums, _ in view)
    seen = shrunk(view, blocks)[0]
    if not whole.sum() > 0.0:
        return Own(seen, math.nan, math.nan)
    sums, counts = view[2]
    elsewhere = float(sums[blocks].sum() / max(counts[blocks].sum(), 1.0))  # mean square
    share_of = max(float(whole.sum()), HARDLY**2 * elsewhere * float(counts[proof].sum()))
    less = math.sqrt(was.sum() / share_of) - math.sqrt(now.sum() / share_of)
    return Own(seen, less, float(np.abs(was - now).sum()) / share_of)
