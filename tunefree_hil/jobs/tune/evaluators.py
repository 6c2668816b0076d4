"""Three ways to score sets of parameters: over the bus in lockstep, over the bus in real time, in a compiled batch."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

from tunefree_hil.base.errors import BenchError, NotValid
from tunefree_hil.bench import Bench
from tunefree_hil.bench.batch import Batch, Driven, Job
from tunefree_hil.bus.bench_channel import ErrorCode
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.grade.objectives import measure_objectives
from tunefree_hil.grade.score import GRADED_ENDS, ScenarioGrade, combine_scores
from tunefree_hil.jobs.run_folder import delete_logs
from tunefree_hil.jobs.running.episode_results import EpisodeResult, evaluation_from_episodes
from tunefree_hil.jobs.running.lateness import judge_realtime
from tunefree_hil.jobs.running.trial_driver import DriveJob, TrialDriver
from tunefree_hil.tune.trial import Evaluation

MAX_REPEATS = 5  # of a late drive; then the machine is too slow


class Medium(StrEnum):
    """How candidates are driven; the value of "over" in progress events."""

    BUS = "bus"
    REALTIME_BUS = "bus in real time"
    BATCH = "batch"


class VectorCandidate(NamedTuple):
    """A complete vector to score. group: its position in the run folder, baselines first, then the slots."""

    group: int
    values: Mapping[str, float]


class Evaluator(Protocol):
    """Scores candidates over the scenarios of a bench file. batch_size: suitable number of candidates in one call."""

    batch_size: int
    medium: Medium

    @property
    def pace(self) -> dict[str, float]: ...

    def evaluate(self, candidates: Sequence[VectorCandidate]) -> list[Evaluation]: ...


def with_objectives(evaluation: Evaluation, bench: Bench, objectives: Sequence[str]) -> Evaluation:
    """The evaluation with the objectives of its drives; unchanged where the evaluator has measured them itself."""
    if evaluation.error or evaluation.objectives or not objectives:
        return evaluation
    return evaluation._replace(objectives=measure_objectives(evaluation.scenarios, bench.weights, objectives))


class RealtimeDriver:
    """Drives jobs at 100 Hz of wall time; a drive that was not in real time is discarded and driven again.

    drives: Number of drives. repeats: Number of discarded drives, those of earlier sessions included.
    """

    def __init__(self, driver: TrialDriver, *, repeats: int = 0) -> None:
        self.driver = driver
        self.drives = 0
        self.repeats = self._earlier_repeats = repeats

    def drive_jobs(self, jobs: Sequence[DriveJob], *, go_on: bool) -> dict[int, EpisodeResult | BenchError]:
        """Drive the jobs; results by job number. Raises NotValid where a drive was late MAX_REPEATS + 1 times."""
        results: dict[int, EpisodeResult | BenchError] = {}
        pending, worst_ms = list(jobs), 0.0
        for _ in range(1 + MAX_REPEATS):
            driven = self.driver.drive_jobs(pending, go_on=go_on)
            self.drives += len(pending)
            verdicts = {k: self._judge(k) for k, result in driven.items() if _may_be_late(result)}
            late = {k: _worst_ms(verdict) for k, verdict in verdicts.items() if not verdict["valid"]}
            results |= {k: result for k, result in driven.items() if k not in late}
            pending = [job for job in pending if job.k in late]
            if not pending:
                return results
            self.repeats += len(pending)
            worst_ms = late[pending[0].k]
            for job in pending:
                delete_logs(self.driver.run.episode(job.k))
        raise NotValid(
            f"{pending[0].scenario.name} was not in real time {1 + MAX_REPEATS} times in a row, {worst_ms:.0f} ms "
            f"late; {self.repeats - self._earlier_repeats} of {self.drives} drives were discarded",
            code="not_realtime",
            hint="use a machine with less load, or tune in lockstep (without --realtime)",
        )

    def _judge(self, k: int) -> dict[str, Any]:
        bench = self.driver.bench
        return judge_realtime(self.driver.run, [k], bench.codec, draw=False, faults=bench.spec.faults)


def _worst_ms(verdict: Mapping[str, Any]) -> float:
    return max((node["max_ms"] for node in verdict["nodes"].values()), default=math.nan)


def _may_be_late(result: EpisodeResult | BenchError) -> bool:
    """Whether a drive ended by itself or by an error that late frames may cause; a lost node is no such error."""
    return isinstance(result, EpisodeResult) or result.code.upper() in ErrorCode.__members__


class BusEvaluator:
    """Scores over the bus; with `realtime` at 100 Hz of wall time.

    A lost node raises BenchError for a single candidate; of several only the evaluation of that candidate fails.
    """

    def __init__(
        self,
        driver: TrialDriver,
        scenarios: Sequence[ScenarioSpec],
        *,
        batch_size: int = 1,
        realtime: RealtimeDriver | None = None,
    ) -> None:
        self.driver = driver
        self.scenarios = list(scenarios)
        self.batch_size = batch_size
        self.realtime = realtime
        self.medium = Medium.BUS if realtime is None else Medium.REALTIME_BUS

    @property
    def pace(self) -> dict[str, float]:
        """Speed against real time, frames per second, and in real time the number of discarded drives."""
        discarded = {} if self.realtime is None else {"discarded": self.realtime.repeats}
        return {**self.driver.pace, **discarded}

    def evaluate(self, candidates: Sequence[VectorCandidate]) -> list[Evaluation]:
        """The evaluation of each candidate."""
        jobs = {candidate.group: self._jobs(candidate) for candidate in candidates}
        driver = self.driver if self.realtime is None else self.realtime
        all_jobs = [job for group_jobs in jobs.values() for job in group_jobs]
        results = driver.drive_jobs(all_jobs, go_on=len(candidates) > 1)
        evaluations = []
        for group_jobs in jobs.values():
            errors = [error for job in group_jobs if isinstance(error := results[job.k], BenchError)]
            if errors and len(candidates) == 1:
                raise errors[0]
            episodes = {
                job.scenario.name: episode for job in group_jobs if isinstance(episode := results[job.k], EpisodeResult)
            }
            evaluations.append(_failed_evaluation(errors[0]) if errors else evaluation_from_episodes(episodes))
        return evaluations

    def _jobs(self, candidate: VectorCandidate) -> list[DriveJob]:
        first = candidate.group * len(self.scenarios)
        return [DriveJob(k, scenario, candidate.values) for k, scenario in enumerate(self.scenarios, first)]


def _failed_evaluation(error: BenchError) -> Evaluation:
    return Evaluation(0.0, {}, error=f"{error.code}: {error.message}")


class BatchEvaluator:
    """Scores in a compiled batch, bit for bit as over the bus."""

    def __init__(self, batch: Batch, bench: Bench, scenarios: Sequence[ScenarioSpec], *, batch_size: int) -> None:
        self.batch = batch
        self.bench = bench
        self.scenarios = list(scenarios)
        self.batch_size = batch_size
        self.medium = Medium.BATCH
        self._simulated_s = self._wall_s = 0.0

    @property
    def pace(self) -> dict[str, float]:
        """Speed against real time; there are no frames."""
        return {"speed_x": self._simulated_s / self._wall_s} if self._wall_s else {}

    def evaluate(self, candidates: Sequence[VectorCandidate]) -> list[Evaluation]:
        """The evaluation of each candidate; all drives are one batch."""
        started = time.monotonic()
        jobs = [Job(candidate.values, scenario) for candidate in candidates for scenario in self.scenarios]
        drives = self.batch.drive(jobs)
        self._wall_s += time.monotonic() - started
        self._simulated_s += sum(drive.ticks for drive in drives) * self.bench.dt_s
        n = len(self.scenarios)
        return [self._evaluation(drives[i * n : (i + 1) * n]) for i in range(len(candidates))]

    def _evaluation(self, drives: Sequence[Driven]) -> Evaluation:
        scenarios: dict[str, Any] = {}
        grades: list[ScenarioGrade] = []
        for scenario, drive in zip(self.scenarios, drives, strict=True):
            grade = grade_of(drive, scenario)
            grades.append(grade)
            scenarios[scenario.name] = grade.as_data() | ({"frame_hash": drive.hash} if drive.hash else {})
        return Evaluation(combine_scores(grades), scenarios)


def grade_of(drive: Driven, scenario: ScenarioSpec) -> ScenarioGrade:
    """The grade of a drive. Raises BenchError where the bench failed, and not the candidate."""
    if drive.error not in GRADED_ENDS or drive.grade is None:
        code = ErrorCode[drive.error.upper()]
        raise BenchError(f"{scenario.name}: {code.sentence} (tick {drive.ticks})", code=drive.error)
    return drive.grade
