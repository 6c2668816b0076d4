"""How long the grading of an episode takes: what the score needs, and all metrics of a profile."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from tools.measures._in_process import InProcess
from tools.measures._summary import machine, rounded, summary
from tunefree_hil.bench import follower_of, load, parameters_of
from tunefree_hil.episode.columns import columns_from_frames
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.profile import DriveExtras, profile_drive
from tunefree_hil.grade.score import ScenarioEnd, grade_drive, grade_vehicle_from_spec

VALUE = "ms to grade 30 s of driving: the 18 weighed metrics and the score, a drive without re-plans (median)"
EPISODE_S = 30.0


def measure(runs: int = 50, scenario: str = "u_turn", bench: str = "bench_configs/mkz_steer.toml") -> dict[str, Any]:
    """Drive a scenario once in one process, then grade it `runs` times.

    detail: the same with two re-plans marked in it (the errors against the path are then recomputed), and the profile
    of all metrics. Times are scaled to 30 s of driving.
    """
    before, loaded = machine(), load(bench)
    spec, values = loaded.scenarios[scenario], parameters_of(loaded)
    drive = InProcess(loaded).drive(spec, values)
    follower, course = follower_of(loaded, spec, values), loaded.course(spec)
    recording = columns_from_frames(drive.frames, loaded.codec, follower, loaded.dt_s, ticks=drive.ticks)
    replanned, car = _with_replans(recording), grade_vehicle_from_spec(loaded.vehicle)
    scale = EPISODE_S / (recording.ticks * recording.dt_s)

    def timed(work: Callable[[], Any]) -> list[float]:
        work()
        found = []
        for _ in range(runs):
            started = time.perf_counter()
            work()
            found.append(1e3 * scale * (time.perf_counter() - started))
        return found

    plain = timed(lambda: grade_drive(recording, course, loaded.weights, car, ScenarioEnd(scenario)))
    again = timed(lambda: grade_drive(replanned, course, loaded.weights, car, ScenarioEnd(scenario)))
    whole = timed(lambda: profile_drive(recording, course, car, extras=DriveExtras(np.full(recording.ticks, 1e-3), "")))
    detail = {
        "machine": before,
        "scenario": scenario,
        "seconds_driven": recording.ticks * recording.dt_s,
        "with_two_replans_ms": float(np.median(again)),
        "profile_of_all_metrics_ms": float(np.median(whole)),
    }
    return summary(plain, "ms", rounded(detail))


def _with_replans(recording: Recording) -> Recording:
    """The same drive with re-plans marked at a third and two thirds of it."""
    replan = np.zeros(recording.ticks)
    replan[[recording.ticks // 3, 2 * recording.ticks // 3]] = 1.0
    return recording._replace(columns={**recording.columns, "replan": replan})
