"""Runs a study in a process of its own and says how far it is: drive_study.py FILE SAMPLER TRIALS SLEEP_S."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.tune.space import make_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.study import Evaluation, open_study
from tunefree_hil.tune.trial_loop import run_trials


class Parameter(NamedTuple):
    name: str
    low: float
    high: float
    scale: str = "log"
    step: float | None = None
    choices: tuple[float, ...] | None = None


SPACE = make_space(
    [
        Parameter("lqr.q1", 0.01, 1.0),
        Parameter("station.kp", 0.01, 1.0),
        Parameter("look_ahead_m", 0.0, 1.4, "linear", step=0.2),
        Parameter("riccati", 0.0, 1.0, "linear", choices=(0.0, 1.0)),
    ]
)
FIRST = SPACE.clip({"lqr.q1": 0.05, "station.kp": 0.2, "look_ahead_m": 0.0, "riccati": 0.0})


def settings(sampler: str) -> StudySettings:
    return StudySettings(SPACE, seed=3, sampler=sampler, bench_hash="sha256:00", first=FIRST)


def bowl(parameters: dict[str, float]) -> Evaluation:
    """A bowl in the logarithms, rounded so coarsely that many trials tie, which the order of trials then decides."""
    score = (math.log10(parameters["lqr.q1"]) + 1.3) ** 2 + (math.log10(parameters["station.kp"]) + 0.5) ** 2
    score += 0.1 + parameters["look_ahead_m"] + 0.3 * parameters["riccati"]
    return Evaluation(round(score, 1), {"bowl": {"score": round(score, 1), "replans": 0}})


def main(path: str, sampler: str, trials: str, sleep_s: str) -> None:
    def evaluate(parameters: dict[str, float]) -> Evaluation:
        print("evaluating", flush=True)
        time.sleep(float(sleep_s))
        return bowl(parameters)

    with open_study(Path(path), settings(sampler)) as study:
        for trial in run_trials(study, int(trials), evaluate):
            print("filled", trial.slot, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
