"""A study in a file, `study.db`: every trial is stored when it begins and when it ends, so a kill costs one evaluation.

Composition: `Study` owns the open file and its `StoredTrials`; `run_trials` of trial_loop.py fills its slots.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import optuna

from tunefree_hil.base.errors import TunefreeError
from tunefree_hil.tune import store
from tunefree_hil.tune.optuna_study import StoredTrials
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.trial import Baseline, Evaluate, EvaluateAll, Evaluation, Trial, failure_text, find_best_trial
from tunefree_hil.tune.trial_loop import Outcomes, Points

__all__ = [
    "Baseline",
    "Evaluate",
    "EvaluateAll",
    "Evaluation",
    "Study",
    "Trial",
    "open_study",
    "read_study",
]


class Study:
    """A study in a file. Make it with `open_study` or `read_study`; close it, or use it in a `with`."""

    def __init__(self, path: Path, file: store.StudyFile) -> None:
        self.path = path
        self.stored = StoredTrials(file.study)
        self.settings = self.stored.settings
        self._file = file

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        store.close_study_file(self._file)

    def trials(self) -> list[Trial]:
        """The filled slots, in slot order."""
        return self.stored.trials()

    def failures(self) -> list[Trial]:
        """The failed attempts in the order in which they were made."""
        return self.stored.failures()

    def best(self) -> Trial | None:
        """The best trial (`find_best_trial`); None before the first trial."""
        return find_best_trial(self.trials())

    def baselines(self) -> dict[str, Baseline]:
        """The stored baselines by name."""
        return self.stored.baselines()

    def add_baseline(self, name: str, parameters: Mapping[str, float], evaluation: Evaluation) -> None:
        """Store the score of a baseline with the study."""
        self.stored.add_baseline(name, parameters, evaluation)

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock the file for this process, and end the trials that a stopped process left running as failed."""
        with store.exclusive_lock(self.path):
            self.stored.fail_unfinished()
            yield

    def begin(self, points: Points) -> dict[int, optuna.Trial]:
        """Store a running trial for each slot."""
        return {slot: self.stored.ask(slot, values) for slot, values in points.items()}

    def end(self, begun: dict[int, optuna.Trial], points: Points, outcomes: Outcomes) -> list[Trial]:
        """Store the score of each slot, or its error."""
        trials = []
        for slot, outcome in outcomes.items():
            if isinstance(outcome, TunefreeError):
                trials.append(self.stored.tell_failed(begun[slot], failure_text(outcome)))
            else:
                trials.append(self.stored.tell(begun[slot], outcome))
        return trials


def open_study(path: Path, settings: StudySettings) -> Study:
    """Open the study at `path` (`study.db` in the run folder), or make it.

    Raises:
        InputError: The study was started with other settings; the message names them.
    """
    return Study(path, store.open_study_file(path, settings))


def read_study(path: Path) -> Study:
    """Open the study at `path` with the settings that it has. Raises InputError where there is none."""
    return Study(path, store.read_study_file(path))
