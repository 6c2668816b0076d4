"""Drives sets of parameters over scenarios; reads and grades one episode while the next is driven."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from concurrent import futures
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from tunefree_hil.base.errors import BenchError
from tunefree_hil.bench import Bench
from tunefree_hil.bus.bench_channel import ErrorCode
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.jobs.harvest import DRIVEN, Episode, harvest
from tunefree_hil.jobs.run_folder import RunFolder, drop_bulk
from tunefree_hil.jobs.session import Session
from tunefree_hil.nodes.runner import Outcome

ROLES = ("ecu", "controller")
TIMING_LIMIT_S = 1.0


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
        self._mend()
        numbered = list(enumerate(scenarios, first))
        waiting = deque(sorted(numbered, key=lambda one: -self.bench.course(one[1]).ticks))  # longest first
        reading: dict[str, Future[Episode]] = {}
        started = time.monotonic()

        def lane(session: Session) -> None:
            while not self._stopping:
                try:
                    k, scenario = waiting.popleft()
                except IndexError:
                    return
                folder = self.run.episode(k)
                try:
                    outcome = self._drive(session, scenario, values, folder)
                except BenchError:
                    self._broken.append(session)
                    raise
                if keep and not session.join:
                    gather_timing(session.processes.folder, folder)
                reading[scenario.name] = self._reader.submit(
                    self._read, session.realtime, scenario, values, outcome, folder, keep
                )

        driving = [self._lanes.submit(lane, session) for session in self.sessions]
        try:
            for future in driving:
                future.result()
        except BenchError:
            waiting.clear()
            futures.wait(driving)  # the other lanes end the drive they are at
            raise
        self.wall_s += time.monotonic() - started
        return {scenario.name: reading[scenario.name].result() for _, scenario in numbered}

    def _mend(self) -> None:
        """Start anew the benches that failed in the last drives: a lost node fails a trial, not the study."""
        broken, self._broken = self._broken, []
        for session in broken:
            session.reopen()

    def _drive(self, session: Session, scenario: ScenarioSpec, values: Mapping[str, float], folder: Path) -> Outcome:
        for role in ROLES:
            (session.processes.folder / f"timing-{role}.npz").unlink(missing_ok=True)
        outcome = session.drive(scenario, self._seed_of(scenario), values, folder)
        self.simulated_s += outcome.ticks * self.bench.dt_s
        self.frames += sum(outcome.logged.values())
        code = ErrorCode(outcome.error_code) if outcome.error_code else ErrorCode.NONE
        if code is not ErrorCode.NONE and code not in DRIVEN:
            raise BenchError(
                f"{scenario.name}: {code.sentence} (tick {outcome.ticks})",
                code=code.name.lower(),
                file=str(folder),
                hint=f"what the nodes said: {session.processes.folder}; the frames: {folder / 'vehicle.log'}",
            )
        return outcome

    def _seed_of(self, scenario: ScenarioSpec) -> int:
        return scenario.noise_seed if self.seed is None else self.seed

    def _read(
        self,
        realtime: bool,
        scenario: ScenarioSpec,
        values: Mapping[str, float],
        outcome: Outcome,
        folder: Path,
        keep: bool,
    ) -> Episode:
        episode = harvest(
            self.bench, scenario, values, outcome, folder, seed=self._seed_of(scenario), realtime=realtime
        )
        if not keep:
            drop_bulk(folder)
        return episode


def gather_timing(words: Path, folder: Path) -> dict[str, np.ndarray]:
    """Put the nodes' cycle times of the last episode into `folder/timing.npz`; {'ecu_late_s': ..., ...}."""
    found: dict[str, np.ndarray] = {}
    limit = time.monotonic() + TIMING_LIMIT_S
    for role in ROLES:
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
