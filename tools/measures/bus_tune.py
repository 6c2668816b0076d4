"""How long a study of 800 trials x 7 scenarios takes over the bus on this machine, from the first trials of one.

The trials are those of `tune` itself: its benches side by side, its logs, grades and database. A trial's seconds are
those that the study stores, from its asking to its telling. What the sampler needs before it asks grows with what is
known already, so that is timed apart, over the whole length of the study.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import optuna
from optuna.trial import TrialState

from tools.measures._ledger import FOLDER, code_hash
from tools.measures._summary import RESAMPLES, machine, rounded
from tunefree_hil.base.errors import InputError
from tunefree_hil.jobs.options.records import TuneOptions
from tunefree_hil.jobs.run_folder import RunFolder, open_run
from tunefree_hil.jobs.tune.tune import tune
from tunefree_hil.tune.sampling import ScoredPoint, suggest_point
from tunefree_hil.tune.space import Space
from tunefree_hil.tune.store import STUDY_NAME
from tunefree_hil.tune.study import read_study

VALUE = "minutes that 800 trials x 7 scenarios take over the bus here (extrapolated; aim 45, at most 120)"
FIRST = 10  # trials that TPE draws at random: more of them fail early, and take less time, than later ones
STEP = 100  # the sampler is timed at every so many known trials
REPEATS = 5


class Timed(NamedTuple):
    """What one run of `tune` left: seconds of each filled slot, in slot order, and drives that ended early."""

    seconds: list[float]
    early: int
    drives: int
    space: Space
    sampler: str
    told: list[ScoredPoint]
    speed_x: float  # of this session's drives together, against real time; nan where all were there before


def measure(
    trials: int = 100,
    of: int = 800,
    benches: int = 0,
    bench: str = "bench_configs/mkz_complete.toml",
    folder: str = FOLDER,
) -> dict[str, Any]:
    """Drive `trials` trials of a study of `of`; extrapolate. Goes on when called again; 0 benches: as `tune` chooses.

    The interval is a bootstrap over trials: the first ten stand for themselves, the others for all that follow.
    """
    before = machine()
    timed = _timed(Path(folder) / "bus_tune" / code_hash()[:16], trials, benches, Path(bench))
    sampling_s = _sampling_s(timed, of)
    totals_s = _totals_s(timed.seconds, of) + sampling_s
    low, high = (float(edge) / 60.0 for edge in np.percentile(totals_s[1:], [2.5, 97.5]))
    detail = {
        "machine": before,
        "bench": bench,
        "of": of,
        "parameters": len(timed.space.axes),
        "sampler": timed.sampler,
        "seconds_a_trial": float(np.median(timed.seconds)),
        "seconds_of_the_sampler": sampling_s,
        "drives": timed.drives,
        "drives_ended_early": timed.early,
        "x_real_time": None if np.isnan(timed.speed_x) else timed.speed_x,
        "not_counted": "start of the processes, baselines, figures, verification",
    }
    value = float(totals_s[0]) / 60.0
    return {"value": value, "unit": "min", "n": len(timed.seconds), "low": low, "high": high, "detail": rounded(detail)}


def _timed(folder: Path, trials: int, benches: int, bench: Path) -> Timed:
    """Run or go on with the study."""
    folder.mkdir(parents=True, exist_ok=True)
    asked = TuneOptions(
        bench, trials=trials, verify=False, benches=benches, out=folder, session=f"bus-tune-{os.getpid()}"
    )
    old = _last_run(folder)
    speed_x = float("nan")
    for event in tune(asked if old is None else asked._replace(resume=old.path)):
        if event.kind != "line":
            print(event.message, file=sys.stderr, flush=True)
        if event.data.get("label") == "trial":
            speed_x = float(event.data.get("speed_x", speed_x))
    run = _last_run(folder)
    assert run is not None
    return _read(run, trials)._replace(speed_x=speed_x)


def _last_run(folder: Path) -> RunFolder | None:
    for path in sorted(folder.glob("*-tune-*"), reverse=True):
        try:
            return open_run(path)
        except InputError:  # cut off before it began
            continue
    return None


def _read(run: RunFolder, trials: int) -> Timed:
    path = run.path / "study.db"
    with read_study(path) as ours:
        known, settings = ours.trials()[:trials], ours.settings
    storage = optuna.storages.RDBStorage(f"sqlite:///{path}")
    try:
        frozen = optuna.load_study(study_name=STUDY_NAME, storage=storage).get_trials(states=(TrialState.COMPLETE,))
    finally:
        storage.remove_session()
        storage.engine.dispose()
    took_s = {one.user_attrs["slot"]: one.duration.total_seconds() for one in frozen if one.duration is not None}
    drives = [drive for trial in known for drive in trial.scenarios.values()]
    early = sum(drive["outcome"] != "finished" for drive in drives)
    told = [ScoredPoint(trial.parameters, trial.score) for trial in known]
    # Trials in flight together share their time: each has its part of the generation's.
    seconds = [took_s[trial.slot] / max(1, settings.in_flight) for trial in known]
    return Timed(seconds, early, len(drives), settings.space, settings.sampler, told, float("nan"))


def _totals_s(seconds: Sequence[float], of: int) -> np.ndarray:
    """Seconds of `of` trials without the sampler: first the estimate, then its bootstrap."""
    first, rest = np.asarray(seconds[:FIRST]), np.asarray(seconds[FIRST:] or seconds)
    drawn = np.random.default_rng(1).choice(rest, (RESAMPLES, len(rest))).mean(axis=1)
    return float(first.sum()) + (of - len(first)) * np.concatenate([[rest.mean()], drawn])


def _sampling_s(timed: Timed, of: int) -> float:
    """Seconds of the sampler over a study of `of`: timed at 0, 100, ... known trials, these repeated to have enough."""
    places = list(range(0, of + 1, min(STEP, of)))
    costs = []
    for known in places:
        history = [timed.told[i % len(timed.told)] for i in range(known)]
        walls = []
        for repeat in range(REPEATS):
            started = time.perf_counter()
            suggest_point(timed.space, history, sampler=timed.sampler, seed=repeat, slot=known)
            walls.append(time.perf_counter() - started)
        costs.append(float(np.median(walls)))
    return float(np.trapezoid(costs, places))
