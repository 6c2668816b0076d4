"""Many drives in this process: a Simulator, threads that share its drives, and each drive's grade."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

from tunefree_hil.bench.load import Bench
from tunefree_hil.bench.simulator import Job, Simulator
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.score import GRADED_ENDS, ScenarioEnd, ScenarioGrade, grade_drive, grade_vehicle_from_spec


class Driven(NamedTuple):
    """Result of a drive. ticks: rows driven; error: '' when it was driven to its end, else the error's name.

    grade: None where the bench failed and not the parameters. recording: only where requested. hash: None, as there
    are no frames.
    """

    grade: ScenarioGrade | None
    ticks: int
    error: str
    recording: Recording | None = None
    hash: str | None = None


class Fleet:
    """Drives of a bench and a model, `threads` at once (None: one a core that this process may use).

    Kernels release the interpreter's lock, so threads use the cores.
    """

    def __init__(self, bench: Bench, model: str, extra_effects: Sequence[str], threads: int | None = None) -> None:
        self.simulator = Simulator(bench, model, extra_effects)
        self._vehicle = grade_vehicle_from_spec(bench.vehicle)
        self._pool = ThreadPoolExecutor(threads or len(os.sched_getaffinity(0)))

    def drive(self, jobs: Sequence[Job], *, columns: bool = False) -> list[Driven]:
        """The drives, in the order of `jobs`. An exception is raised when the jobs before it are done; running
        drives then end, drives that have not started are dropped.
        """
        first = [self._one(job, columns) for job in jobs[:1]]  # it may compile, and the others would wait for that
        return first + list(self._pool.map(lambda job: self._one(job, columns), jobs[1:]))

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown(cancel_futures=True)

    def _one(self, job: Job, columns: bool) -> Driven:
        simulator, scenario = self.simulator, job.scenario
        drive = simulator.drive(job)
        bench = simulator.bench
        graded = None
        if drive.error in GRADED_ENDS:
            course = bench.course(scenario)
            end = ScenarioEnd(scenario.name, drive.error)
            graded = grade_drive(drive.recording, course, bench.weights, self._vehicle, end)
        return Driven(graded, drive.ticks, drive.error, drive.recording if columns else None)
