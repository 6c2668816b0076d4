"""How much faster than real time a drive is, in lockstep over the bus."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tools.measures._summary import machine, rounded, summary
from tunefree_hil.bench import Bench, is_heavy, load, parameters_of
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession

VALUE = "times real time in lockstep: nominal plant, hub, ECU and controller as processes, MRAC, noise, logs (median)"


def measure(
    runs: int = 5,
    scenarios: str = "",
    reference: int = 1,
    bench: str = "bench_configs/mkz_steer.toml",
) -> dict[str, Any]:
    """Drive the bench file's scenarios (or those of `scenarios`, with commas between) `runs` times.

    Time runs from the start of an episode to its end as the runner sees it, logs closed; grading is not in it.
    reference = 0 leaves out the verify model.
    """
    before, loaded = machine(), load(bench)
    names = [name for name in loaded.spec.scenarios if not scenarios or name in scenarios.split(",")]
    nominal = _factors(loaded, loaded.spec.model, names, runs)
    detail: dict[str, Any] = {"machine": before, "scenarios": names, loaded.spec.model: nominal}
    if reference:
        detail[loaded.spec.verify_model] = _factors(loaded, loaded.spec.verify_model, names, runs)
    return summary(nominal["factors"], "x real time", rounded(detail))


def _factors(bench: Bench, model: str, names: list[str], runs: int) -> dict[str, Any]:
    """{factors: one a run, by scenario: median, frames_per_s, median}. Episode 0 is driven before and not counted."""
    values = parameters_of(bench)
    walls: list[dict[str, float]] = []
    simulated, frames = dict.fromkeys(names, 0.0), 0
    with (
        tempfile.TemporaryDirectory() as folder,
        BenchSession(
            Path(bench.file),
            Path(folder) / "nodes",
            BenchLaunch(session=f"lockstep-{os.getpid()}", model=model, jitted_ecu=is_heavy(bench, model)),
        ) as session,
    ):
        for run in range(-1, runs):
            wall = {}
            for name in names if run >= 0 else names[:1]:
                episode = Path(folder) / f"{run}-{name}"
                episode.mkdir()
                scenario = bench.scenarios[name]
                outcome = session.drive(scenario, scenario.noise_seed, values, episode)
                wall[name], simulated[name] = outcome.wall_s, outcome.ticks * bench.dt_s
                frames += sum(outcome.logged.values()) if run >= 0 else 0
            walls.append(wall)
    counted = walls[1:]
    factors = [sum(simulated.values()) / sum(wall.values()) for wall in counted]
    return {
        "factors": factors,
        "median": float(np.median(factors)),
        "scenarios": {name: simulated[name] / float(np.median([wall[name] for wall in counted])) for name in names},
        "simulated_s_a_run": sum(simulated.values()),
        "frames_per_s": frames / sum(sum(wall.values()) for wall in counted),
        "compiled_ecu": is_heavy(bench, model),
    }
