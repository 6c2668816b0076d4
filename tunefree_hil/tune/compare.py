"""The best of the baselines, which a tuned result is compared with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.trial import Baseline


class BestBaseline(NamedTuple):
    """The best baseline. Stored under its field names.

    replans: Sum over its scenarios.
    violation: Of the requirements of the study, 0 where they are met.
    """

    name: str
    score: float
    replans: int
    violation: float = 0.0


def find_best_baseline(baselines: Mapping[str, Baseline]) -> BestBaseline:
    """The best baseline: requirements first, then score, then the first. Raises InputError without baselines."""
    if not baselines:
        raise InputError("no baseline was scored", code="no_baseline", hint="score one with Study.add_baseline")
    name = min(baselines, key=lambda name: (baselines[name].violation, baselines[name].score))
    best = baselines[name]
    replans = sum(int(drive.get("replans", 0) or 0) for drive in best.scenarios.values())
    return BestBaseline(name, best.score, replans, best.violation)
