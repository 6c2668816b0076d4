"""A worker of a shared study in a process of its own.

drive_worker.py URL FOLDER TRIALS SLEEP_S GRACE_S PATIENCE_S END_S
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from tests.tune.drive_study import bowl, settings
from tunefree_hil.base.errors import TunefreeError
from tunefree_hil.tune.shared.finalisation import Finalisation
from tunefree_hil.tune.shared.shared_study import join_study
from tunefree_hil.tune.trial import Evaluation


def main(url: str, folder: str, trials: str, sleep_s: str, grace_s: str, patience_s: str, end_s: str) -> None:
    def evaluate(points: Mapping[int, dict[str, float]]) -> list[Evaluation]:
        print("evaluating", flush=True)
        time.sleep(float(sleep_s))
        return [bowl(parameters) for parameters in points.values()]

    asked = settings("tpe_independent")._replace(in_flight=0)
    where = Path(folder)
    where.mkdir(exist_ok=True)
    with join_study(url, asked, where, grace_s=float(grace_s), patience_s=float(patience_s)) as study:
        for trial in study.run_trials(int(trials), evaluate):
            print("said " + trial if isinstance(trial, str) else f"filled {trial.slot}", flush=True)
        with Finalisation(study, "these trials") as ending:
            for words in ending.wait_for_parts(("winner",)):
                print("said " + words, flush=True)
            if ending.is_ours:
                print("ours", flush=True)
                time.sleep(float(end_s))
                list(ending.store_parts(winner=where.name))
        print(f"{'last' if ending.is_ours else 'over'} {ending.parts['winner']}", flush=True)


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except TunefreeError as error:
        print(error.as_dict(), file=sys.stderr, flush=True)
        os._exit(error.exit_status)
