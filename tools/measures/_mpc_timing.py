"""Times of the control cycle, and counts of the plans, in the controller's process: in lockstep and in real time."""

from __future__ import annotations

import itertools
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tunefree_hil.bench import is_heavy, load, parameters_of
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.episode_results import plan_counts
from tunefree_hil.jobs.running.lateness import judge_realtime
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession
from tunefree_hil.jobs.running.trial_driver import TrialDriver


def measure_times(file: str, seconds: float) -> dict[str, Any]:
    """Times of a bench with its manual set: {lockstep, realtime}, each over `seconds` of driving or more."""
    return {name: _times(file, seconds, realtime=name == "realtime") for name in ("lockstep", "realtime")}


def _times(file: str, seconds: float, *, realtime: bool) -> dict[str, Any]:
    bench = load(file)
    model = bench.spec.model
    with tempfile.TemporaryDirectory() as folder:
        run = RunFolder(Path(folder), {})
        launch = BenchLaunch(
            session=f"mpc-times-{os.getpid()}", model=model, realtime=realtime, jitted_ecu=is_heavy(bench, model)
        )
        episodes = 0
        with BenchSession(Path(bench.file), run.node_output(), launch) as session:
            driver = TrialDriver(session, bench, run)
            try:
                for name in itertools.cycle(bench.spec.scenarios):
                    if driver.simulated_s >= seconds:
                        break
                    driver.drive_scenarios(parameters_of(bench), [bench.scenarios[name]], episodes)
                    episodes += 1
            finally:
                driver.close()
        verdict = {"was_real_time": judge_realtime(run, range(episodes), draw=False)["valid"]} if realtime else {}
        return {**_read(run, episodes), **verdict}


def _read(run: RunFolder, episodes: int) -> dict[str, Any]:
    cycles, plans = [], [plan_counts(run.episode(k)) for k in range(episodes)]
    for k in range(episodes):
        with np.load(run.episode(k) / "timing.npz") as data:
            cycles.append(data["controller_control_time_s"])
    cycle_ms = 1e3 * np.concatenate(cycles)
    return {
        "ticks": len(cycle_ms),
        "cycle_ms": {"median": float(np.median(cycle_ms)), "p99": float(np.percentile(cycle_ms, 99))},
        "longest_ms": float(cycle_ms.max()),
        "plans": {part: _sum([row[part] for row in plans]) for part in plans[0]},
    }


def _sum(rows: list[Any]) -> dict[str, int]:
    """Counts of a part over the episodes."""
    total = {name: sum(getattr(row, name) for row in rows) for name in ("ticks", "bounded", "failed", "iterations")}
    return {**total, "most_iterations": max(row.most_iterations for row in rows)}
