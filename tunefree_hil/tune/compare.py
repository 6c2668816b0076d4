"""What a tuned result is held against: the best of the baselines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.study import Baseline


class Standing(NamedTuple):
    """The best of the baselines. `replans`: over all its scenarios, to be said beside a comparison (interfaces 7)."""

    name: str
    score: float
    replans: int


def best_baseline(baselines: Mapping[str, Baseline]) -> Standing:
    """The baseline of the lowest score, the first of equals. Raises InputError when there is none."""
    if not baselines:
        raise InputError("no baseline was scored", code="no_baseline", hint="score one with Study.add_baseline")
    name = min(baselines, key=lambda one: baselines[one].score)
    best = baselines[name]
    return Standing(name, best.score, sum(int(drive.get("replans", 0) or 0) for drive in best.scenarios.values()))
