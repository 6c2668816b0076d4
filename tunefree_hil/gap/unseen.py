"""What an effect does to its own signal on blocks that prove, held against what it does on those that judged it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.ask import Modelled
from tunefree_hil.gap.decide import shrunk

Array = np.ndarray


class Own(NamedTuple):
    """seen, unseen: by how much an effect shrinks a target's error on the blocks that judged it and on those that
    prove, as a share of the null's; NaN where those have nothing of the target. stirs: share of the null's squares by
    which it changes any block that proves, for better or worse: who stirs nothing is not shown there.
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
    if not whole.sum() > 0.0:
        return Own(shrunk(view, blocks)[0], math.nan, math.nan)
    return Own(shrunk(view, blocks)[0], shrunk(view, proof)[0], float(np.abs(was - now).sum() / whole.sum()))
