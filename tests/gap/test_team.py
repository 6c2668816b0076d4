"""How suspects are dealt out: grids for all, fits for those that gain something there."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from tunefree_hil.gap.scan import Start
from tunefree_hil.gap.team import HOPELESS, SCREEN, Team

GAINS = {"best": 1000.0, "near": 400.0, "far": 60.0, "trifle": 5.0, "nothing": 0.1}


class Process:
    """Stands in for a worker: knows what each suspect gains and writes down what it is asked to fit."""

    def __init__(self) -> None:
        self.fitted: list[str] = []
        self.bars: list[float] = []

    def result(self, module: str, function: str, token: str, *args: Any) -> dict[str, Any]:
        if function == "scan_suspects":
            return {name: Start((), np.zeros(0), GAINS[name]) for name in args[0]}
        begins, _, bar = args
        self.fitted += list(begins)
        self.bars.append(bar)
        return {name: f"{name} fitted" for name in begins}


def team() -> tuple[Team, list[Process]]:
    one = Team(cast(Any, None), workers=0)
    workers = [Process(), Process()]
    one.workers = cast(Any, workers)
    return one, workers


def test_who_gains_nothing_beside_the_best_is_not_fitted_and_who_is_far_gets_one_step() -> None:
    one, workers = team()
    assert set(one.fit(list(GAINS), None)) == {"best", "near", "far"}
    assert all(worker.bars == [max(HOPELESS, SCREEN * GAINS["best"])] for worker in workers)
    assert GAINS["near"] > workers[0].bars[0] > GAINS["far"]


def test_those_that_take_long_are_shared_evenly() -> None:
    one, workers = team()
    one.fit(list(GAINS), None)
    assert [worker.fitted for worker in workers] == [["best", "far"], ["near"]]


def test_nobody_to_ask_is_no_mistake() -> None:
    assert team()[0].fit([], None) == {}
