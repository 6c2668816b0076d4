"""The best of the baselines, which a tuned result is compared with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.study import Baseline


class BestBaseline(NamedTuple):
    """The baseline with the lowest score. replans: sum over its scenarios. Stored under its field names."""

    name: str
    score: float
    replans: int


def find_best_baseline(baselines: Mapping[str, Baseline]) -> BestBaseline:
    """The baseline with the lowest score, the first of equals. Raises InputError without baselines."""
    if not baselines:
        raise InputError("no baseline was scored", code="no_baseline", hint="score one with Study.add_baseline")
    name = min(baselines, key=lambda name: baselines[name].score)
    best = baselines[name]
    return BestBaseline(name, best.score, sum(int(drive.get("replans", 0) or 0) for drive in best.scenarios.values()))
