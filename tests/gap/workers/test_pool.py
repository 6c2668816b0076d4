"""How suspects are dealt out: grids for all, fits for those that gain something there."""

from __future__ import annotations

from threading import Event
from typing import Any, cast

import numpy as np
import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.estimation.grid import Start
from tunefree_hil.gap.workers.pool import HOPELESS, SCREEN, Team

GAINS = {"best": 1000.0, "near": 400.0, "far": 60.0, "trifle": 5.0, "nothing": 0.1}


class Process:
    """Stands in for a worker: knows what each suspect gains and writes down what it is asked to fit."""

    def __init__(self) -> None:
        self.fitted: list[str] = []
        self.bars: list[float] = []
        self.noises: list[Any] = []
        self.closed = Event()

    def result(self, module: str, function: str, token: str, *args: Any) -> tuple[dict[str, Any], dict[str, str]]:
        self.noises.append(args[-1])
        if function == "scan_suspects":
            can = {
                name: Start((), np.zeros(0), GAINS[name], moves=0.1 if args[-1] is None else 0.7)
                for name in args[0]
                if name in GAINS
            }
            return can, {name: "no value of it makes a car" for name in args[0] if name not in GAINS}
        begins, _, bar, _ = args
        self.fitted += list(begins)
        self.bars.append(bar)
        return {name: f"{name} fitted" for name in begins}, {}

    def end(self) -> None:
        self.closed.set()


class Lost(Process):
    """One that fails at once."""

    def result(self, module: str, function: str, token: str, *args: Any) -> Any:
        raise InputError("the process is gone", code="gone")


class Busy(Process):
    """One that computes until it is ended."""

    def result(self, module: str, function: str, token: str, *args: Any) -> Any:
        assert self.closed.wait(20.0)
        raise InputError("ended", code="gone")


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


def test_who_makes_no_car_is_told_with_the_reason_and_only_where_it_was_asked_alone() -> None:
    one, _ = team()
    one.fit(["best", "wall"], None)
    assert one.dropped == {"wall": "no value of it makes a car"}
    one.fit(["best", "other wall"], cast(Any, type("Beside", (), {"fitted": object()})()))
    assert "other wall" not in one.dropped


def test_asked_again_under_the_noise_of_another_the_grids_and_the_fits_have_it_and_what_effects_move_stays() -> None:
    one, workers = team()
    one.fit(list(GAINS), None)
    assert {noise for worker in workers for noise in worker.noises} == {None}
    workers[0].noises, workers[1].noises = [], []
    one.fit(list(GAINS), None, cast(Any, type("Best", (), {"fitted": "the best one's"})()))
    assert [worker.noises for worker in workers] == [["the best one's"] * 2] * 2
    assert set(one.moves.values()) == {0.1}  # as it was by the null's noise: excitation is no matter of who is best


def test_where_one_process_fails_the_others_are_ended_and_not_waited_for() -> None:
    one, _ = team()
    one.workers = cast(Any, [Busy(), Lost()])
    with pytest.raises(InputError):
        one.fit(list(GAINS), None)
    assert all(cast(Process, worker).closed.is_set() for worker in one.workers)


def test_nobody_to_ask_is_no_mistake() -> None:
    assert team()[0].fit([], None) == {}
