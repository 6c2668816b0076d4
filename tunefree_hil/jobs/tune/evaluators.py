"""Three ways to score sets of parameters: over the bus in lockstep, over the bus in real time, in a compiled batch."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from tunefree_hil.base.errors import BenchError, NotValid
from tunefree_hil.bench import Bench
from tunefree_hil.bench.batch import Batch, Driven, Job
from tunefree_hil.bus.bench_channel import ErrorCode
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.grade.score import GRADED, ScenarioGrade, combine
from tunefree_hil.jobs.run_folder import drop_bulk
from tunefree_hil.jobs.running.episode_results import Episode, evaluation_of
from tunefree_hil.jobs.running.lateness import judge_realtime
from tunefree_hil.jobs.running.trial_driver import DriveJob, Track
from tunefree_hil.tune.trial import Evaluation

MOST_REPEATS = 5  # of one drive, before the machine is said not to be up to it


class Candidate(NamedTuple):
    """A complete vector to score. `group`: its place in the run folder, baselines first, then the slots."""

    group: int
    values: Mapping[str, float]


class Evaluator(Protocol):
    """Scores candidates over the scenarios of a bench file. `at_once`: how many it takes well in one call."""

    at_once: int
    over: str  # "bus", "bus in real time", "batch"

    @property
    def pace(self) -> dict[str, float]: ...

    def evaluate(self, candidates: Sequence[Candidate]) -> list[Evaluation]: ...


class BusEvaluator:
    """Over the bus. One candidate: a lost node raises BenchError; of several, it costs the candidate that had it."""

    def __init__(self, track: Track, scenarios: Sequence[ScenarioSpec], *, at_once: int = 1) -> None:
        self.track = track
        self.scenarios = list(scenarios)
        self.at_once = at_once
        self.over = "bus"

    @property
    def pace(self) -> dict[str, float]:
        """Speed against real time and frames per second."""
        return self.track.pace

    def evaluate(self, candidates: Sequence[Candidate]) -> list[Evaluation]:
        """The evaluation of each candidate."""
        jobs = {one.group: self._jobs(one) for one in candidates}
        found = self._drive([job for some in jobs.values() for job in some], go_on=len(candidates) > 1)
        evaluations = []
        for some in jobs.values():
            errors = [error for job in some if isinstance(error := found[job.k], BenchError)]
            if errors and len(candidates) == 1:
                raise errors[0]
            episodes = {job.scenario.name: one for job in some if isinstance(one := found[job.k], Episode)}
            evaluations.append(_lost(errors[0]) if errors else evaluation_of(episodes))
        return evaluations

    def _jobs(self, candidate: Candidate) -> list[DriveJob]:
        first = candidate.group * len(self.scenarios)
        return [DriveJob(k, scenario, candidate.values) for k, scenario in enumerate(self.scenarios, first)]

    def _drive(self, jobs: Sequence[DriveJob], *, go_on: bool) -> dict[int, Episode | BenchError]:
        return self.track.drive_some(jobs, go_on=go_on)


class RealtimeEvaluator(BusEvaluator):
    """Over the bus at 100 Hz of wall time. A drive that was not real time is discarded and driven again.

    `drives`: how many there were. `repeats`: how many were discarded, those of earlier sessions (argument) included.
    Nobody else ever sees those.
    """

    def __init__(self, track: Track, scenarios: Sequence[ScenarioSpec], *, at_once: int = 1, repeats: int = 0) -> None:
        super().__init__(track, scenarios, at_once=at_once)
        self.over = "bus in real time"
        self.drives = 0
        self.repeats = self._before = repeats

    @property
    def pace(self) -> dict[str, float]:
        """Also how many drives were discarded."""
        return {**self.track.pace, "discarded": self.repeats}

    def _drive(self, jobs: Sequence[DriveJob], *, go_on: bool) -> dict[int, Episode | BenchError]:
        """Raises NotValid where a drive was not real time MOST_REPEATS + 1 times in a row."""
        found: dict[int, Episode | BenchError] = {}
        todo, worst_ms = list(jobs), 0.0
        for _ in range(1 + MOST_REPEATS):
            again = self.track.drive_some(todo, go_on=go_on)
            self.drives += len(todo)
            verdicts = {k: self._verdict(k) for k, one in again.items() if _may_be_late(one)}
            late = {k: _worst_ms(verdict) for k, verdict in verdicts.items() if not verdict["valid"]}
            found |= {k: one for k, one in again.items() if k not in late}
            todo = [job for job in todo if job.k in late]
            if not todo:
                return found
            self.repeats += len(todo)
            worst_ms = late[todo[0].k]
            for job in todo:
                drop_bulk(self.track.run.episode(job.k))
        raise NotValid(
            f"{todo[0].scenario.name} was not real time {1 + MOST_REPEATS} times in a row, {worst_ms:.0f} ms late; "
            f"{self.repeats - self._before} of {self.drives} drives were discarded",
            code="not_realtime",
            hint="give the bench a machine with less to do, or tune in lockstep (without --realtime)",
        )

    def _verdict(self, k: int) -> dict[str, Any]:
        bench = self.track.bench
        return judge_realtime(self.track.run, [k], bench.codec, draw=False, faults=bench.spec.faults)


def _worst_ms(verdict: Mapping[str, Any]) -> float:
    return max((node["max_ms"] for node in verdict["nodes"].values()), default=math.nan)


def _may_be_late(one: Episode | BenchError) -> bool:
    """A drive that ended, be it because frames came too late for the vehicle; a lost node is no question of time."""
    return isinstance(one, Episode) or one.code.upper() in ErrorCode.__members__


class BatchEvaluator:
    """In a compiled batch: the numbers of the bus without the bus."""

    def __init__(self, batch: Batch, bench: Bench, scenarios: Sequence[ScenarioSpec], *, at_once: int) -> None:
        self.batch = batch
        self.bench = bench
        self.scenarios = list(scenarios)
        self.at_once = at_once
        self.over = "batch"
        self._simulated_s = self._wall_s = 0.0

    @property
    def pace(self) -> dict[str, float]:
        """Speed against real time; there are no frames."""
        return {"speed_x": self._simulated_s / self._wall_s} if self._wall_s else {}

    def evaluate(self, candidates: Sequence[Candidate]) -> list[Evaluation]:
        """The evaluation of each candidate; all drives of all of them are one batch."""
        started = time.monotonic()
        driven = self.batch.drive([Job(one.values, scenario) for one in candidates for scenario in self.scenarios])
        self._wall_s += time.monotonic() - started
        self._simulated_s += sum(one.ticks for one in driven) * self.bench.dt_s
        n = len(self.scenarios)
        return [self._graded(driven[i * n : (i + 1) * n]) for i in range(len(candidates))]

    def _graded(self, driven: Sequence[Driven]) -> Evaluation:
        kept: dict[str, Any] = {}
        grades: list[ScenarioGrade] = []
        for scenario, one in zip(self.scenarios, driven, strict=True):
            if one.error not in GRADED or one.grade is None:
                code = ErrorCode[one.error.upper()]
                raise BenchError(f"{scenario.name}: {code.sentence} (tick {one.ticks})", code=one.error)
            grades.append(one.grade)
            kept[scenario.name] = one.grade._asdict() | ({"frame_hash": one.hash} if one.hash else {})
        return Evaluation(combine(grades), kept)


def _lost(error: BenchError) -> Evaluation:
    return Evaluation(0.0, {}, error=f"{error.code}: {error.message}")
