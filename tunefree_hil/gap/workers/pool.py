"""The processes that share a question: each has it open, suspects are dealt out among them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from typing import Any, TypeVar

from tunefree_hil.gap.estimation.grid import Start
from tunefree_hil.gap.estimation.residuals import Setting
from tunefree_hil.gap.workers.worker import Modelled, Question
from tunefree_hil.learn.compiled_process import Worker

T = TypeVar("T")

MODULE = "tunefree_hil.gap.workers.worker"
HOPELESS = 1.0  # squares that the best point of a grid gains: who gains less is not fitted
LEFT_OUT = 0.01  # nor who gains less than that of what the best one's best point gains
SCREEN = 0.15  # who gains less than that gets one step: the truth, even midway between two points, gains more


class Team:
    """Processes that have the same question open. dropped: who could not be asked at all, with the reason; moves: what
    each suspect alone moves of any target at the most (scan.Start). thorough: whether all suspects are fitted, however
    little they gain.
    """

    def __init__(self, setting: Setting, workers: int = 2, *, thorough: bool = False) -> None:
        self.setting = setting
        self.thorough = thorough
        self.workers = [Worker() for _ in range(workers)]
        self.token = "gap"
        self.dropped: dict[str, str] = {}
        self.moves: dict[str, float] = {}

    def open(self) -> Question:
        """Open it in all of them."""
        return self._all([("open_question", self.token, self.setting)] * len(self.workers))[0]

    def fit(self, names: Sequence[str], start: Modelled | None, noise: Modelled | None = None) -> dict[str, Modelled]:
        """Suspects beside `start`, shared out: all grids first; who is far behind the best there gets one step only, or
        none where there is nothing that it gains. noise: the model whose noise says what is gained (None: start's).
        """
        model, by = (None if one is None else one.fitted for one in (start, noise))
        begins: dict[str, Start] = {}
        for some, lost in self._all([("scan_suspects", self.token, share, model, by) for share in self._shares(names)]):
            begins |= some
            self._drop(lost, model is None)
        if start is None and noise is None:
            self.moves |= {name: one.moves for name, one in begins.items()}
        best = max((one.gain for one in begins.values()), default=0.0)
        order = sorted(begins, key=lambda name: -begins[name].worth)
        least, bar = (
            (-math.inf, 0.0) if self.thorough else (max(HOPELESS, LEFT_OUT * best), max(HOPELESS, SCREEN * best))
        )
        asked = [name for name in order if begins[name].worth > least]
        shares = [{name: begins[name] for name in share} for share in self._shares(asked)]
        found: dict[str, Modelled] = {}
        for some, lost in self._all([("fit_suspects", self.token, share, model, bar, by) for share in shares]):
            found |= some
            self._drop(lost, model is None)
        return found

    def _drop(self, lost: Mapping[str, str], alone: bool) -> None:
        """Who is no car beside another effect was a car alone, and was asked."""
        if alone:
            self.dropped |= lost

    def fit_on(self, models: Sequence[Modelled]) -> list[Modelled]:
        """Models fitted on until nothing is gained, in their order."""
        shares = self._shares(list(range(len(models))))
        calls = [("fitted_on", self.token, [models[i].fitted for i in share]) for share in shares]
        found: dict[int, Modelled] = {}
        for share, some in zip(shares, self._all(calls), strict=True):
            found |= dict(zip(share, some, strict=True))
        return [found[i] for i in range(len(models))]

    def fit_without(self, model: Modelled, names: Sequence[str]) -> dict[str, Modelled]:
        """A model without each of its effects `names`, the rest fitted on."""
        found: dict[str, Modelled] = {}
        for some in self._all([("fitted_without", self.token, model.fitted, share) for share in self._shares(names)]):
            found |= some
        return found

    def _shares(self, some: Sequence[T]) -> list[list[T]]:
        return [list(some[i :: len(self.workers)]) for i in range(len(self.workers))]

    def ask(self, function: str, *args: Any) -> Any:
        """Ask the first."""
        return self.workers[0].result(MODULE, function, self.token, *args)

    def close(self) -> None:
        """End the processes."""
        for worker in self.workers:
            worker.end()

    def _all(self, calls: Sequence[tuple[Any, ...]]) -> list[Any]:
        pool = ThreadPoolExecutor(len(self.workers))
        try:
            todo = [pool.submit(one.result, MODULE, *call) for one, call in zip(self.workers, calls, strict=True)]
            for one in wait(todo, return_when=FIRST_EXCEPTION).done:
                one.result()  # raises where it failed, whoever else is still at work
            return [one.result() for one in todo]
        except BaseException:
            self.close()  # nobody waits for what the others still compute
            raise
        finally:
            pool.shutdown()
