"""Drive parameter sets over scenarios; one episode is read and graded while the next is driven."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import BenchError
from tunefree_hil.bench import Bench
from tunefree_hil.bus.bench_channel import ErrorCode
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.grade.score import GRADED_ENDS
from tunefree_hil.jobs.run_folder import RunFolder, delete_logs
from tunefree_hil.jobs.running.episode_results import ROLES, DrivenEpisode, EpisodeResult, read_episode
from tunefree_hil.jobs.running.foreign_frames import watch_foreign_frames
from tunefree_hil.jobs.running.session import BenchSession

TIMING_LIMIT_S = 1.0


class DriveJob(NamedTuple):
    """One drive: number in the run folder, scenario, and complete parameter vector."""

    k: int
    scenario: ScenarioSpec
    values: Mapping[str, float]


class TrialDriver:
    """Drives jobs on parallel benches ("lanes") into one run folder. The lane does not influence the frames.

    simulated_s, wall_s, frames: sums over all drives.
    """

    def __init__(
        self, sessions: BenchSession | Sequence[BenchSession], bench: Bench, run: RunFolder, *, seed: int | None = None
    ) -> None:
        self.sessions = [sessions] if isinstance(sessions, BenchSession) else list(sessions)
        self.bench = bench
        self.run = run
        self.seed = seed
        self.simulated_s = 0.0
        self.wall_s = 0.0
        self.frames = 0
        self._stopping = False
        self._broken: list[BenchSession] = []
        self._lanes = ThreadPoolExecutor(max_workers=len(self.sessions), thread_name_prefix="lane")
        self._reader = ThreadPoolExecutor(max_workers=1, thread_name_prefix="harvest")

    def close(self) -> None:
        """Stop the drives, and wait for the episode being read."""
        self._stopping = True
        for session in self.sessions:
            with contextlib.suppress(BenchError):  # a lane that lost its bench has already ended
                session.runner.stop()
        self._lanes.shutdown(wait=True, cancel_futures=True)
        self._reader.shutdown(wait=True, cancel_futures=True)

    @property
    def pace(self) -> dict[str, float]:
        """Speed against real time and frames per second over all lanes, for progress events."""
        if self.wall_s <= 0.0:
            return {}
        return {"speed_x": self.simulated_s / self.wall_s, "frames_per_s": self.frames / self.wall_s}

    def drive_scenarios(
        self, values: Mapping[str, float], scenarios: Iterable[ScenarioSpec], first: int, *, keep: bool = True
    ) -> dict[str, EpisodeResult]:
        """Drive each scenario with these parameters as episodes first, first + 1, ...; keep=False drops logs.

        Raises BenchError when a drive ended for a reason other than its parameters.
        """
        jobs = [DriveJob(k, scenario, values) for k, scenario in enumerate(scenarios, first)]
        results = self.drive_jobs(jobs, keep=keep)
        for result in results.values():
            if isinstance(result, BenchError):
                raise result
        return {job.scenario.name: episode for job in jobs if isinstance(episode := results[job.k], EpisodeResult)}

    def drive_jobs(
        self, jobs: Sequence[DriveJob], *, keep: bool = True, go_on: bool = False
    ) -> dict[int, EpisodeResult | BenchError]:
        """Drive jobs on all lanes. Returns the result or error of each job by its number.

        Args:
            keep: Keep logs and columns.
            go_on: A failed drive ends its lane only; else it ends all lanes, and the remaining jobs get its error.
        """
        self._reopen_broken()
        waiting = deque(sorted(jobs, key=lambda job: -self.bench.course(job.scenario).ticks))  # longest first
        reading: dict[int, Future[EpisodeResult]] = {}
        failed: dict[int, BenchError] = {}
        started = time.monotonic()

        def lane(session: BenchSession) -> None:
            while not self._stopping and (go_on or not failed):
                try:
                    job = waiting.popleft()
                except IndexError:
                    return
                folder = self.run.episode(job.k)
                try:
                    driven = self._drive(session, job, folder)
                except BenchError as error:
                    failed[job.k] = error
                    self._broken.append(session)
                    if session.launch.realtime:
                        collect_timing(session.processes.folder, folder, _timed_roles(session))
                    return
                if keep and not session.launch.join:
                    collect_timing(session.processes.folder, folder, _timed_roles(session))
                reading[job.k] = self._reader.submit(self._read, driven, keep)

        driving = [self._lanes.submit(lane, session) for session in self.sessions]
        for future in driving:
            future.result()
        self.wall_s += time.monotonic() - started
        first = next(iter(failed.values()), BenchError("the drives were stopped", code="stopped"))
        return {job.k: failed.get(job.k) or (reading[job.k].result() if job.k in reading else first) for job in jobs}

    def _reopen_broken(self) -> None:
        """Restart the benches that failed in the last drives: a lost node fails a trial, not the study."""
        while self._broken:
            self._broken[0].reopen()  # on failure it remains in the list, as do the others
            self._broken.pop(0)

    def _drive(self, session: BenchSession, job: DriveJob, folder: Path) -> DrivenEpisode:
        scenario = job.scenario
        seed = scenario.noise_seed if self.seed is None else self.seed
        for role in ROLES:
            (session.processes.folder / f"timing-{role}.npz").unlink(missing_ok=True)
        with watch_foreign_frames(session.owner, self.bench.codec):
            outcome = session.drive(scenario, seed, job.values, folder)
        self.simulated_s += outcome.ticks * self.bench.dt_s
        self.frames += sum(outcome.logged.values())
        if outcome.error not in GRADED_ENDS:
            message = f"{scenario.name}: {ErrorCode(outcome.error_code).sentence} (tick {outcome.ticks})"
            hint = f"output of the nodes: {session.processes.folder}; frames: {folder / 'vehicle.log'}"
            raise BenchError(message, code=outcome.error, file=str(folder), hint=hint)
        return DrivenEpisode(scenario, job.values, outcome, folder, seed, session.launch.realtime)

    def _read(self, driven: DrivenEpisode, keep: bool) -> EpisodeResult:
        episode = read_episode(self.bench, driven)
        if not keep:
            delete_logs(driven.folder)
        return episode


def _timed_roles(session: BenchSession) -> tuple[str, ...]:
    """Nodes that write cycle times; a foreign controller does not."""
    return ROLES[:1] if session.launch.controller_command else ROLES


def collect_timing(output_folder: Path, folder: Path, roles: Sequence[str]) -> None:
    """Collect the nodes' cycle times of the last episode into `folder/timing.npz`: {'ecu_late_s': ..., ...}."""
    times: dict[str, np.ndarray] = {}
    limit = time.monotonic() + TIMING_LIMIT_S
    for role in roles:
        path = output_folder / f"timing-{role}.npz"
        while not path.is_file() and time.monotonic() < limit:
            time.sleep(0.01)
        if path.is_file():
            with np.load(path) as data:
                times |= {f"{role}_{name}": data[name] for name in data.files}
    if times:
        part = folder / "timing.npz.part"
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **times)
        shutil.move(part, folder / "timing.npz")
