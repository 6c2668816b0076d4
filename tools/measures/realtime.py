"""How late the nodes' ticks are in real time: on an idle machine, and with every core burning; and what it changes."""

from __future__ import annotations

import itertools
import os
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tools.measures._burners import burning
from tools.measures._in_process import InProcess
from tools.measures._ledger import FIGURES
from tools.measures._summary import RESAMPLES, machine, rounded
from tunefree_hil.bench import Bench, is_heavy, load, parameters_of
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.lateness import CRITERIA, judge_realtime
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession
from tunefree_hil.jobs.running.trial_driver import ROLES, TrialDriver

VALUE = "ms late, p99 over the ticks of the later node at 100 Hz, idle machine"
BLOCK_S = 1.0  # ticks near one another are late together: whole seconds are drawn for the interval


def measure(
    seconds: int = 600,
    burning_s: int = 60,
    model: str = "",
    bench: str = "bench_configs/mkz_steer.toml",
    figures: str = FIGURES,
) -> dict[str, Any]:
    """Drive scenarios of the bench file one after the other until `seconds` are full; then `burning_s` with a busy
    process on each core.

    n counts ticks of one node; low and high are the 95 % interval of the p99 by bootstrap over blocks of 1 s.
    agreement: tracking figures in real time against those in lockstep, by scenario.
    """
    before, loaded = machine(), load(bench)
    idle = _paced(loaded, model or loaded.spec.model, seconds)
    later = max(idle.late, key=lambda role: float(np.percentile(idle.late[role], 99)))
    low, high = _interval_s(idle.late[later], round(BLOCK_S / loaded.dt_s))
    detail: dict[str, Any] = {
        "machine": before,
        "scenarios": len(idle.names),
        "nodes": idle.verdict["nodes"],
        "later_node": later,
        "late_means_ms": 1e3 * CRITERIA.late_s,
        "never_later_than_ms": 1e3 * CRITERIA.max_late_s,
        "was_real_time": idle.verdict["valid"],
        "agreement": _agreement(loaded, model or loaded.spec.model, idle),
        "figure": _figure(idle.late, figures),
    }
    if burning_s:
        with burning(os.cpu_count() or 1):
            busy = _paced(loaded, model or loaded.spec.model, burning_s)
        detail["burning"] = {"nodes": busy.verdict["nodes"], "was_real_time": busy.verdict["valid"]}
    value = 1e3 * float(np.percentile(idle.late[later], 99))
    return {"value": value, "unit": "ms", "n": len(idle.late[later]), "low": 1e3 * low, "high": 1e3 * high,
            "detail": rounded(detail)}  # fmt: skip


class Paced(NamedTuple):
    """Drives in real time: scenarios in order, verdict, lateness by node, the last grade of each scenario."""

    names: list[str]
    verdict: dict[str, Any]
    late: dict[str, np.ndarray]
    grades: dict[str, ScenarioGrade]


def _paced(bench: Bench, model: str, seconds: float) -> Paced:
    with tempfile.TemporaryDirectory() as folder:
        run = RunFolder(Path(folder), {})
        names, grades = _drive(bench, model, run, seconds)
        verdict = judge_realtime(run, range(len(names)))
        return Paced(names, verdict, {role: _late_s(run, role, len(names)) for role in ROLES}, grades)


def _agreement(bench: Bench, model: str, paced: Paced) -> dict[str, Any]:
    """Score and lateral peak (m) of each scenario in real time and in lockstep, and the largest difference."""
    lockstep = InProcess(bench, model)
    rows = {}
    for name, timed in paced.grades.items():
        stepped, _ = lockstep.grade(bench.scenarios[name], parameters_of(bench))
        peaks = [0.5 * (one.metrics["lateral_err_peak"] or 0.0) for one in (timed, stepped)]
        rows[name] = {"score": [timed.score, stepped.score], "lateral_peak_m": peaks}
    return {
        "realtime_and_lockstep": rows,
        "largest_score_difference": max(abs(a - b) for a, b in (row["score"] for row in rows.values())),
        "largest_peak_difference_m": max(abs(a - b) for a, b in (row["lateral_peak_m"] for row in rows.values())),
    }


def _drive(bench: Bench, model: str, run: RunFolder, seconds: float) -> tuple[list[str], dict[str, ScenarioGrade]]:
    """The scenarios driven, in order, and their last grades; what was driven is read before the next begins."""
    driven: list[str] = []
    grades: dict[str, ScenarioGrade] = {}
    with BenchSession(
        Path(bench.file),
        run.node_output(),
        BenchLaunch(session=f"realtime-{os.getpid()}", model=model, realtime=True, jitted_ecu=is_heavy(bench, model)),
    ) as session:
        track = TrialDriver(session, bench, run)
        try:
            for name in itertools.cycle(bench.spec.scenarios):
                if track.simulated_s >= seconds:
                    return driven, grades
                found = track.drive_scenarios(parameters_of(bench), [bench.scenarios[name]], len(driven))
                grades[name] = next(iter(found.values())).grade
                driven.append(name)
        finally:
            track.close()
    return driven, grades


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
    from tunefree_hil.figures.jitter import draw_jitter
    from tunefree_hil.figures.style import save

    rows = {role: [float(one) for one in values] for role, values in late.items()}
    return str(save(draw_jitter(rows, CRITERIA.late_s), Path(figures) / "realtime.png"))
