"""How late the nodes' ticks are in real time, with nothing else to do for the machine."""

from __future__ import annotations

import itertools
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tools.measures._ledger import FIGURES
from tools.measures._summary import RESAMPLES, machine, rounded
from tunefree_hil.bench import Bench, is_heavy, load, parameters_of
from tunefree_hil.jobs.lateness import LATE_S, NEVER_LATER_S, judge_realtime
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.session import Session
from tunefree_hil.jobs.track import ROLES, Track

VALUE = "ms late, p99 over the ticks of the later node at 100 Hz, idle machine"
BLOCK_S = 1.0  # ticks near one another are late together: whole seconds are drawn for the interval


def measure(
    seconds: int = 60, model: str = "", bench: str = "bench_configs/mkz_steer.toml", figures: str = FIGURES
) -> dict[str, Any]:
    """Drive scenarios of the bench file one after the other until `seconds` are full.

    n counts ticks of one node; low and high are the 95 % interval of the p99 by bootstrap over blocks of 1 s.
    """
    before, loaded = machine(), load(bench)
    with tempfile.TemporaryDirectory() as folder:
        run = RunFolder(Path(folder), {})
        names = _drive(loaded, model or loaded.spec.model, run, seconds)
        verdict = judge_realtime(run, range(len(names)))
        late = {role: _late_s(run, role, len(names)) for role in ROLES}
    later = max(late, key=lambda role: float(np.percentile(late[role], 99)))
    low, high = _interval_s(late[later], round(BLOCK_S / loaded.dt_s))
    detail = {
        "machine": before,
        "scenarios": names,
        "nodes": verdict["nodes"],
        "later_node": later,
        "late_means_ms": 1e3 * LATE_S,
        "never_later_than_ms": 1e3 * NEVER_LATER_S,
        "was_real_time": verdict["valid"],
        "figure": _figure(late, figures),
    }
    value = 1e3 * float(np.percentile(late[later], 99))
    return {"value": value, "unit": "ms", "n": len(late[later]), "low": 1e3 * low, "high": 1e3 * high,
            "detail": rounded(detail)}  # fmt: skip


def _drive(bench: Bench, model: str, run: RunFolder, seconds: float) -> list[str]:
    """The scenarios driven, in order; what was driven is read before the next begins."""
    driven: list[str] = []
    with Session(
        Path(bench.file),
        run.words(),
        session=f"realtime-{os.getpid()}",
        model=model,
        realtime=True,
        jitted_ecu=is_heavy(bench, model),
    ) as session:
        track = Track(session, bench, run)
        try:
            for name in itertools.cycle(bench.spec.scenarios):
                if track.simulated_s >= seconds:
                    return driven
                track.drive_all(parameters_of(bench), [bench.scenarios[name]], len(driven))
                driven.append(name)
        finally:
            track.close()
    return driven


def _late_s(run: RunFolder, role: str, episodes: int) -> np.ndarray:
    rows = []
    for k in range(episodes):
        with np.load(run.episode(k) / "timing.npz") as data:
            rows.append(data[f"{role}_late_s"])
    return np.concatenate(rows)


def _interval_s(late_s: np.ndarray, block: int) -> tuple[float, float]:
    blocks = late_s[: len(late_s) // block * block].reshape(-1, block)
    rng = np.random.default_rng(1)
    drawn = [np.percentile(blocks[rng.integers(0, len(blocks), len(blocks))], 99) for _ in range(RESAMPLES)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return float(low), float(high)


def _figure(late: dict[str, np.ndarray], figures: str) -> str:
    from tunefree_hil.figures.jitter import write_jitter

    rows = {role: [float(one) for one in values] for role, values in late.items()}
    return str(write_jitter(Path(figures) / "realtime.png", rows, LATE_S))
