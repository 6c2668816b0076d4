"""How candidates are divided among processes: grids for all, fits for those that gain something there."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.estimation.grid import StartPoint
from tunefree_hil.gap.selection.reasons import Criterion, RejectionStage
from tunefree_hil.gap.workers import worker
from tunefree_hil.gap.workers.pool import CRITERIA, WorkerPool

GAINS = {"best": 1000.0, "near": 400.0, "far": 60.0, "trifle": 5.0, "nothing": 0.1}


class FakeProcess:
    """A process that knows what each candidate gains, and records what it has to fit."""

    def __init__(self) -> None:
        self.fitted: list[str] = []
        self.full_fit_gains: list[float] = []
        self.noise_sources: list[Any] = []
        self.closed = Event()

    def wait_for_result(self, function: Callable[..., Any], token: str, *args: Any) -> Any:
        self.noise_sources.append(args[-1])
        if function is worker.scan_candidates:
            starts = {
                name: StartPoint((), np.zeros(0), GAINS[name], max_effect_share=0.1 if args[-1] is None else 0.7)
                for name in args[0]
                if name in GAINS
            }
            return starts, {name: "no value of it gives a possible car" for name in args[0] if name not in GAINS}
        starts, _, full_fit_gain, _ = args
        self.fitted += list(starts)
        self.full_fit_gains.append(full_fit_gain)
        return {name: f"{name} fitted" for name in starts}, {}

    def shut_down(self) -> None:
        self.closed.set()


class FailingProcess(FakeProcess):
    """A process that fails at once."""

    def wait_for_result(self, function: Callable[..., Any], token: str, *args: Any) -> Any:
        raise InputError("the process is gone", code="gone")


class BusyProcess(FakeProcess):
    """A process that computes until it is ended."""

    def wait_for_result(self, function: Callable[..., Any], token: str, *args: Any) -> Any:
        assert self.closed.wait(20.0)
        raise InputError("ended", code="gone")


def make_pool() -> tuple[WorkerPool, list[FakeProcess]]:
    pool = WorkerPool(cast(Any, None), workers=0)
    processes = [FakeProcess(), FakeProcess()]
    pool.workers = cast(Any, processes)
    return pool, processes


def beside(*names: str) -> Any:
    """A model with these effects."""
    return SimpleNamespace(fit=SimpleNamespace(free=[SimpleNamespace(key=f"{name}.size") for name in names]))


def test_a_candidate_that_gains_little_beside_the_best_is_not_fitted_and_a_weak_one_gets_one_step() -> None:
    pool, processes = make_pool()
    assert set(pool.fit_candidates(list(GAINS), None)) == {"best", "near", "far"}
    full_fit_gain = max(CRITERIA.min_gain, CRITERIA.full_fit_share * GAINS["best"])
    assert all(process.full_fit_gains == [full_fit_gain] for process in processes)
    assert GAINS["near"] > full_fit_gain > GAINS["far"]


def test_candidates_that_take_long_are_shared_evenly() -> None:
    pool, processes = make_pool()
    pool.fit_candidates(list(GAINS), None)
    assert [process.fitted for process in processes] == [["best", "far"], ["near"]]


def test_an_impossible_candidate_is_recorded_with_the_reason_only_where_it_is_alone() -> None:
    pool, _ = make_pool()
    pool.fit_candidates(["best", "wall"], None)
    reason = pool.impossible_candidates.pop("wall")
    assert not pool.impossible_candidates and reason.note == "no value of it gives a possible car"
    assert (reason.criterion, reason.stage) == (Criterion.IMPOSSIBLE, RejectionStage.UNTESTABLE)
    pool.fit_candidates(["best", "other wall"], beside("lag"))
    assert "other wall" not in pool.impossible_candidates
    (reason,) = pool.unfitted_beside(beside("lag"))
    assert (reason.name, reason.stage, reason.beside) == ("other wall", RejectionStage.SCREENING, ("lag",))


@given(st.dictionaries(st.sampled_from("abcdefgh"), st.floats(0.0, 2.0) | st.floats(0.0, 1e4), min_size=1))
def test_every_candidate_is_fitted_or_has_its_gain_and_the_least_one_as_a_reason(gains: dict[str, float]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{__name__}.GAINS", gains)
        pool, _ = make_pool()
        fitted = pool.fit_candidates(list(gains), None)
    reasons = {reason.name: reason for reason in pool.unfitted_beside(None)}
    assert set(fitted) | set(reasons) == set(gains) and not set(fitted) & set(reasons)
    least = max(CRITERIA.min_gain, CRITERIA.min_share_of_best * max(gains.values()))
    for name, reason in reasons.items():
        assert (reason.criterion, reason.stage) == (Criterion.SCREENED, RejectionStage.SCREENING)
        assert (reason.value, reason.limit) == (gains[name], least) and gains[name] <= least
    assert pool.unfitted_beside(beside("lag")) == ()


def test_a_fit_by_the_noise_of_another_model_screens_nothing_out() -> None:
    pool, _ = make_pool()
    pool.fit_candidates(["best", "near"], None)
    pool.fit_candidates(list(GAINS), None, beside("lag"))
    assert pool.unfitted_beside(None) == ()


def test_grids_and_fits_use_the_noise_of_another_model_and_effect_shares_stay() -> None:
    pool, processes = make_pool()
    pool.fit_candidates(list(GAINS), None)
    assert {source for process in processes for source in process.noise_sources} == {None}
    processes[0].noise_sources, processes[1].noise_sources = [], []
    best = beside("lag")
    pool.fit_candidates(list(GAINS), None, best)
    assert [process.noise_sources for process in processes] == [[best.fit] * 2] * 2
    assert set(pool.max_effect_shares.values()) == {0.1}  # from the first scan: excitation does not depend on the best


def test_where_one_process_fails_the_others_are_ended_and_not_waited_for() -> None:
    pool, _ = make_pool()
    pool.workers = cast(Any, [BusyProcess(), FailingProcess()])
    with pytest.raises(InputError):
        pool.fit_candidates(list(GAINS), None)
    assert all(cast(FakeProcess, process).closed.is_set() for process in pool.workers)


def test_no_candidates_are_no_error() -> None:
    assert make_pool()[0].fit_candidates([], None) == {}
