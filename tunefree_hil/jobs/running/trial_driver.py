"""Drives sets of parameters over scenarios; reads and grades one episode while the next is driven."""

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
from tunefree_hil.grade.score import GRADED
from tunefree_hil.jobs.run_folder import RunFolder, drop_bulk
from tunefree_hil.jobs.running.episode_results import Episode, harvest
from tunefree_hil.jobs.running.foreign_frames import watched
from tunefree_hil.jobs.running.session import Session
from tunefree_hil.nodes.runner import Outcome

ROLES = ("ecu", "controller")
TIMING_LIMIT_S = 1.0


class DriveJob(NamedTuple):
    """One drive: its number in the run folder, what to drive, with which complete vector."""

    k: int
    scenario: ScenarioSpec
    values: Mapping[str, float]


class Track:
    """Benches side by side ("lanes") and one run folder. Which lane drives a scenario changes nothing in its frames.

    `simulated_s`, `wall_s`, `frames` add up over all drives.
    """

    def __init__(
        self, sessions: Session | Sequence[Session], bench: Bench, run: RunFolder, *, seed: int | None = None
    ) -> None:
        self.sessions = [sessions] if isinstance(sessions, Session) else list(sessions)
        self.bench = bench
        self.run = run
        self.seed = seed
        self.simulated_s = 0.0
        self.wall_s = 0.0
        self.frames = 0
        self._stopping = False
        self._broken: list[Session] = []
        self._lanes = ThreadPoolExecutor(max_workers=len(self.sessions), thread_name_prefix="lane")
        self._reader = ThreadPoolExecutor(max_workers=1, thread_name_prefix="harvest")

    def close(self) -> None:
        """End what is driven, wait for what is being read."""
        self._stopping = True
        for session in self.sessions:
            with contextlib.suppress(BenchError):  # a lane whose bench is gone has ended already
                session.runner.stop()
        self._lanes.shutdown(wait=True, cancel_futures=True)
        self._reader.shutdown(wait=True, cancel_futures=True)

    @property
    def pace(self) -> dict[str, float]:
        """Speed against real time and frames per second, all lanes together, for progress events."""
        if self.wall_s <= 0.0:
            return {}
        return {"speed_x": self.simulated_s / self.wall_s, "frames_per_s": self.frames / self.wall_s}

    def drive_all(
        self, values: Mapping[str, float], scenarios: Iterable[ScenarioSpec], first: int, *, keep: bool = True
    ) -> dict[str, Episode]:
        """Episodes first, first + 1, ...: each scenario with these parameters. keep=False drops logs and columns.

        Raises BenchError when a drive ended for a reason that the parameters do not answer for.
        """
        jobs = [DriveJob(k, scenario, values) for k, scenario in enumerate(scenarios, first)]
        found = self.drive_some(jobs, keep=keep)
        for one in found.values():
            if isinstance(one, BenchError):
                raise one
        return {job.scenario.name: one for job in jobs if isinstance(one := found[job.k], Episode)}

    def drive_some(
        self, jobs: Sequence[DriveJob], *, keep: bool = True, go_on: bool = False
    ) -> dict[int, Episode | BenchError]:
        """What became of each job by its number; the lanes share them. keep=False drops logs and columns.

        go_on: a drive that fails ends its lane only; else it ends all, and those not begun have its error too.
        """
        self._mend()
        waiting = deque(sorted(jobs, key=lambda job: -self.bench.course(job.scenario).ticks))  # longest first
        reading: dict[int, Future[Episode]] = {}
        failed: dict[int, BenchError] = {}
        started = time.monotonic()

        def lane(session: Session) -> None:
            while not self._stopping and (go_on or not failed):
                try:
                    job = waiting.popleft()
                except IndexError:
                    return
                folder = self.run.episode(job.k)
                try:
                    outcome = self._drive(session, job.scenario, job.values, folder)
                except BenchError as error:
                    failed[job.k] = error
                    self._broken.append(session)
                    if session.realtime:
                        gather_timing(session.processes.folder, folder, _timed(session))
                    return
                if keep and not session.join:
                    gather_timing(session.processes.folder, folder, _timed(session))
                reading[job.k] = self._reader.submit(self._read, session.realtime, job, outcome, folder, keep)

        driving = [self._lanes.submit(lane, session) for session in self.sessions]
        for future in driving:
            future.result()
        self.wall_s += time.monotonic() - started
        first = next(iter(failed.values()), BenchError("the drives were stopped", code="stopped"))
        return {job.k: failed.get(job.k) or (reading[job.k].result() if job.k in reading else first) for job in jobs}

    def _mend(self) -> None:
        """Start anew the benches that failed in the last drives: a lost node fails a trial, not the study."""
        while self._broken:
            self._broken[0].reopen()  # where that fails it stays to be mended, and so do the others
            self._broken.pop(0)

    def _drive(self, session: Session, scenario: ScenarioSpec, values: Mapping[str, float], folder: Path) -> Outcome:
        for role in ROLES:
            (session.processes.folder / f"timing-{role}.npz").unlink(missing_ok=True)
        with watched(session.owner, self.bench.codec):
            outcome = session.drive(scenario, self._seed_of(scenario), values, folder)
        self.simulated_s += outcome.ticks * self.bench.dt_s
        self.frames += sum(outcome.logged.values())
        if outcome.error not in GRADED:
            raise BenchError(
                f"{scenario.name}: {ErrorCode(outcome.error_code).sentence} (tick {outcome.ticks})",
                code=outcome.error,
                file=str(folder),
                hint=f"what the nodes said: {session.processes.folder}; the frames: {folder / 'vehicle.log'}",
            )
        return outcome

    def _seed_of(self, scenario: ScenarioSpec) -> int:
        return scenario.noise_seed if self.seed is None else self.seed

    def _read(self, realtime: bool, job: DriveJob, outcome: Outcome, folder: Path, keep: bool) -> Episode:
        seed = self._seed_of(job.scenario)
        episode = harvest(self.bench, job.scenario, job.values, outcome, folder, seed=seed, realtime=realtime)
        if not keep:
            drop_bulk(folder)
        return episode


def _timed(session: Session) -> tuple[str, ...]:
    """Who writes cycle times; a controller of the user's own does not."""
    return ROLES[:1] if session.controller_command else ROLES


def gather_timing(words: Path, folder: Path, roles: Sequence[str] = ROLES) -> dict[str, np.ndarray]:
    """Put the nodes' cycle times of the last episode into `folder/timing.npz`; {'ecu_late_s': ..., ...}.

    roles: those that write them.
    """
    found: dict[str, np.ndarray] = {}
    limit = time.monotonic() + TIMING_LIMIT_S
    for role in roles:
        path = words / f"timing-{role}.npz"
        while not path.is_file() and time.monotonic() < limit:
            time.sleep(0.01)
        if path.is_file():
            with np.load(path) as data:
                found |= {f"{role}_{name}": data[name] for name in data.files}
    if found:
        part = folder / "timing.npz.part"
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **found)
        shutil.move(part, folder / "timing.npz")
    return found
