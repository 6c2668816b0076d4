"""Drives sets of parameters over scenarios; reads and grades one episode while the next is driven."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterable, Mapping
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
    """One session and one run folder. `simulated_s`, `wall_s`, `frames` add up over all drives."""

    def __init__(self, session: Session, bench: Bench, run: RunFolder, *, seed: int | None = None) -> None:
        self.session = session
        self.bench = bench
        self.run = run
        self.seed = seed
        self.simulated_s = 0.0
        self.wall_s = 0.0
        self.frames = 0
        self._reader = ThreadPoolExecutor(max_workers=1, thread_name_prefix="harvest")

    def close(self) -> None:
        """Wait for what is being read."""
        self._reader.shutdown(wait=True, cancel_futures=True)

    @property
    def pace(self) -> dict[str, float]:
        """Speed against real time and frames per second, for progress events."""
        if self.wall_s <= 0.0:
            return {}
        return {"speed_x": self.simulated_s / self.wall_s, "frames_per_s": self.frames / self.wall_s}

    def drive_all(
        self,
        values: Mapping[str, float],
        scenarios: Iterable[ScenarioSpec],
        first: int,
        *,
        keep: bool = True,
        done: Callable[[str], None] = lambda name: None,
    ) -> dict[str, Episode]:
        """Episodes first, first + 1, ...: each scenario with these parameters. keep=False drops logs and columns.

        Raises BenchError when a drive ended for a reason that the parameters do not answer for.
        """
        reading: dict[str, Future[Episode]] = {}
        for k, scenario in enumerate(scenarios, first):
            folder = self.run.episode(k)
            outcome = self._drive(scenario, values, folder)
            done(scenario.name)
            reading[scenario.name] = self._reader.submit(self._read, scenario, values, outcome, folder, keep)
        return {name: future.result() for name, future in reading.items()}

    def _drive(self, scenario: ScenarioSpec, values: Mapping[str, float], folder: Path) -> Outcome:
        outcome = self.session.drive(scenario, self._seed_of(scenario), values, folder)
        self.simulated_s += outcome.ticks * self.bench.dt_s
        self.wall_s += outcome.wall_s
        self.frames += sum(outcome.logged.values())
        code = ErrorCode(outcome.error_code) if outcome.error_code else ErrorCode.NONE
        if code is not ErrorCode.NONE and code not in DRIVEN:
            raise BenchError(
                f"{scenario.name}: {code.sentence} (tick {outcome.ticks})",
                code=code.name.lower(),
                file=str(folder),
                hint=f"what the nodes said: {self.run.words()}; the frames: {folder / 'vehicle.log'}",
            )
        return outcome

    def _seed_of(self, scenario: ScenarioSpec) -> int:
        return scenario.noise_seed if self.seed is None else self.seed

    def _read(
        self, scenario: ScenarioSpec, values: Mapping[str, float], outcome: Outcome, folder: Path, keep: bool
    ) -> Episode:
        realtime = self.session.realtime
        episode = harvest(
            self.bench, scenario, values, outcome, folder, seed=self._seed_of(scenario), realtime=realtime
        )
        if not keep:
            drop_bulk(folder)
        elif not self.session.join:
            gather_timing(self.session.processes.folder, folder)
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
