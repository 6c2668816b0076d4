"""The baseline that a tuned result is held against."""

from __future__ import annotations

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.compare import find_best_baseline
from tunefree_hil.tune.study import Baseline


def test_the_best_baseline_says_that_it_replanned() -> None:
    drives = {"left_turn": {"replans": 1}, "u_turn": {"replans": 2}, "straight": {}}
    baselines = {"as_shipped": Baseline({}, 0.9, {}), "mrac_on": Baseline({}, 0.7, drives)}
    assert find_best_baseline(baselines) == ("mrac_on", 0.7, 3, 0.0)
    unmet = {name: base._replace(violation=0.2 if name == "mrac_on" else 0.0) for name, base in baselines.items()}
    assert find_best_baseline(unmet) == ("as_shipped", 0.9, 0, 0.0), "requirements come before the score"
    with pytest.raises(InputError):
        find_best_baseline({})
