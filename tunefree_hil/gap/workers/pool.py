"""Worker processes that share a problem: each has it open, and the candidates are divided among them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

from tunefree_hil.gap.estimation.grid import StartPoint
from tunefree_hil.gap.estimation.least_squares import Fit
from tunefree_hil.gap.estimation.residuals import ProblemSpec
from tunefree_hil.gap.selection.reasons import Criterion, Reason, RejectionStage
from tunefree_hil.gap.workers import worker
from tunefree_hil.gap.workers.worker import FitSummary, OpenProblem
from tunefree_hil.learn.compiled_process import CompiledProcess

T = TypeVar("T")
P = ParamSpec("P")

TOKEN = "gap"  # the name under which the processes open the problem


class ScreeningCriteria(NamedTuple):
    """Which candidates are fitted, by the gain of their best grid point (docs/results/criteria.md)."""

    min_gain: float = 1.0  # squared residuals, in units of the noise; a candidate that gains less is not fitted
    min_share_of_best: float = 0.01  # nor is one that gains less than this share of the best gain
    # of the best gain; a candidate below it gets one step only. The right effect gains more, even midway between two
    # grid points
    full_fit_share: float = 0.15


CRITERIA = ScreeningCriteria()


class WorkerPool:
    """Processes that have the same problem open.

    Args:
        spec: the problem
        workers: number of processes
        fits_all: fit all candidates fully, however little they gain

    Attributes:
        impossible_candidates: why effects are impossible, of which no value gives a possible car
        max_effect_shares: largest RMS change that each candidate alone makes to a target, as a share of its signal
    """

    def __init__(self, spec: ProblemSpec, workers: int = 2, *, fits_all: bool = False) -> None:
        self.spec = spec
        self.fits_all = fits_all
        self.workers = [CompiledProcess() for _ in range(workers)]
        self.impossible_candidates: dict[str, Reason] = {}
        self._unfitted: dict[tuple[str, ...], tuple[Reason, ...]] = {}  # by the effects in the model added to
        self.max_effect_shares: dict[str, float] = {}

    def open(self) -> OpenProblem:
        """Open the problem in all processes."""
        return self._run_all(worker.open_problem, [(self.spec,)] * len(self.workers))[0]

    def fit_candidates(
        self, names: Sequence[str], start: FitSummary | None, noise_source: FitSummary | None = None
    ) -> dict[str, FitSummary]:
        """Fit candidates, each by itself: first all grids, then fits of those that may compete with the best.

        Args:
            start: the model that they are added to; None for the recalibrated one
            noise_source: the model whose noise is used; None for `start`

        Returns: the fits by candidate, without those that gain nothing or are impossible; why, is in `unfitted_beside`
        """
        base, source = (None if summary is None else summary.fit for summary in (start, noise_source))
        starts: dict[str, StartPoint] = {}
        impossible: dict[str, str] = {}
        calls = [(share, base, source) for share in self._split(names)]
        for share_starts, share_impossible in self._run_all(worker.scan_candidates, calls):
            starts |= share_starts
            impossible |= share_impossible
        if start is None and noise_source is None:
            self.max_effect_shares |= {name: point.max_effect_share for name, point in starts.items()}
        min_gain, full_fit_gain = self._screening_gains(starts)
        order = sorted(starts, key=lambda name: -starts[name].priority)
        fitted = [name for name in order if starts[name].priority > min_gain]
        shares = [{name: starts[name] for name in share} for share in self._split(fitted)]
        fits: dict[str, FitSummary] = {}
        calls = [(share, base, full_fit_gain, source) for share in shares]
        for share_fits, share_impossible in self._run_all(worker.fit_candidates, calls):
            fits |= share_fits
            impossible |= share_impossible
        reasons = _impossible_reasons(impossible, _effect_names(base))
        if base is None:  # beside another effect, a possible one may become impossible
            self.impossible_candidates |= {reason.name: reason for reason in reasons}
        if noise_source is None:  # by the noise of another model, fits are only made again
            screened = {name: point.gain for name, point in starts.items() if point.priority <= min_gain}
            self._unfitted[_effect_names(base)] = (*reasons, *_screening_reasons(screened, min_gain, base))
        return fits

    def unfitted_beside(self, model: FitSummary | None) -> tuple[Reason, ...]:
        """Why candidates were not fitted that were added to a model; None for the recalibrated one."""
        return self._unfitted.get(_effect_names(None if model is None else model.fit), ())

    def _screening_gains(self, starts: Mapping[str, StartPoint]) -> tuple[float, float]:
        """Gains above which a candidate is fitted at all, and above which it is fitted fully."""
        if self.fits_all:
            return -math.inf, 0.0
        best = max((point.gain for point in starts.values()), default=0.0)
        min_gain = max(CRITERIA.min_gain, CRITERIA.min_share_of_best * best)
        return min_gain, max(CRITERIA.min_gain, CRITERIA.full_fit_share * best)

    def refine_fits(self, models: Sequence[FitSummary]) -> list[FitSummary]:
        """Refine models until nothing is gained; in their order."""
        shares = self._split(list(range(len(models))))
        calls = [([models[i].fit for i in share],) for share in shares]
        refined: dict[int, FitSummary] = {}
        for share, summaries in zip(shares, self._run_all(worker.refine_fits, calls), strict=True):
            refined |= dict(zip(share, summaries, strict=True))
        return [refined[i] for i in range(len(models))]

    def fit_without_effects(self, model: FitSummary, names: Sequence[str]) -> dict[str, FitSummary]:
        """The model without each of these effects, by effect, the rest refitted."""
        fits: dict[str, FitSummary] = {}
        for share in self._run_all(worker.fit_without_effects, [(model.fit, share) for share in self._split(names)]):
            fits |= share
        return fits

    def _split(self, items: Sequence[T]) -> list[list[T]]:
        return [list(items[i :: len(self.workers)]) for i in range(len(self.workers))]

    def call(self, function: Callable[Concatenate[str, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call a function of gap/workers/worker.py, without its token, in the first process."""
        return self.workers[0].wait_for_result(function, TOKEN, *args, **kwargs)

    def close(self) -> None:
        """End the processes."""
        for process in self.workers:
            process.shut_down()

    def _run_all(self, function: Callable[..., Any], calls: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Call a function of gap/workers/worker.py in each process, with its arguments; the results in their order."""
        threads = ThreadPoolExecutor(len(self.workers))
        try:
            pairs = zip(self.workers, calls, strict=True)
            todo = [threads.submit(process.wait_for_result, function, TOKEN, *args) for process, args in pairs]
            for future in wait(todo, return_when=FIRST_EXCEPTION).done:
                future.result()  # raises at once where it failed, while others still compute
            return [future.result() for future in todo]
        except BaseException:
            self.close()  # the other results are not needed
            raise
        finally:
            threads.shutdown()


def _effect_names(fit: Fit | None) -> tuple[str, ...]:
    """The effects in a model, in their order; none in the recalibrated one (None)."""
    return () if fit is None else tuple(dict.fromkeys(free.key.partition(".")[0] for free in fit.free))


def _impossible_reasons(messages: Mapping[str, str], beside: tuple[str, ...]) -> tuple[Reason, ...]:
    """messages: what the vehicle model says of each candidate."""
    stage = RejectionStage.SCREENING if beside else RejectionStage.UNTESTABLE
    return tuple(
        Reason(Criterion.IMPOSSIBLE, name, stage=stage, beside=beside, note=message)
        for name, message in messages.items()
    )


def _screening_reasons(gains: Mapping[str, float], min_gain: float, base: Fit | None) -> tuple[Reason, ...]:
    """gains: of the candidates that are not fitted."""
    stage, beside = RejectionStage.SCREENING, _effect_names(base)
    return tuple(
        Reason(Criterion.SCREENED, name, gain, min_gain, stage=stage, beside=beside) for name, gain in gains.items()
    )
