"""A study in a file, `study.db`: every attempt is asked and told there, so a kill loses one evaluation at most."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import optuna
from optuna.trial import TrialState

from tunefree_hil.base.errors import TunefreeError
from tunefree_hil.tune import store
from tunefree_hil.tune.optuna_study import Shelf
from tunefree_hil.tune.store import Settings
from tunefree_hil.tune.trial import CUT_OFF, Baseline, Evaluate, EvaluateAll, Evaluation, Trial
from tunefree_hil.tune.trial_loop import Answers, Filling, Points

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


class Study(Shelf, Filling):
    """A study in a file. Make it with `open_study` or `read_study`; close it, or use it in a `with`."""

    def __init__(self, path: Path, file: store.StudyFile) -> None:
        super().__init__(file.study)
        self.path = path
        self._file = file

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        store.close_file(self._file)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Hold the file, and tell FAIL what a process that is gone had asked for."""
        with store.alone(self.path):
            self._tell_interrupted()
            yield

    def begin(self, points: Points) -> dict[int, optuna.Trial]:
        """Ask each slot: it stands in the file as running."""
        return {slot: self._ask(slot, values) for slot, values in points.items()}

    def end(self, begun: dict[int, optuna.Trial], points: Points, answers: Answers) -> list[Trial]:
        """Tell each slot its score, or FAIL with the error."""
        found = []
        for slot, answer in answers.items():
            if isinstance(answer, TunefreeError):
                text = CUT_OFF if answer.code == CUT_OFF else f"{answer.code}: {answer.message}"
                found.append(self._tell_failed(begun[slot], text))
            else:
                found.append(self._tell(begun[slot], answer))
        return found

    def _tell_interrupted(self) -> None:
        """Without an `error` of its own a trial that is told FAIL reads as interrupted."""
        while self._optuna.get_trials(deepcopy=False, states=(TrialState.WAITING,)):
            self._optuna.ask()  # takes the waiting one: only a running trial can be told
        for frozen in self._optuna.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            self._optuna.tell(frozen.number, state=TrialState.FAIL)


def open_study(path: Path, settings: Settings) -> Study:
    """The study in `path` (`study.db` in the run folder), made if it is not there.

    Raises InputError, which names what differs, for a study that was started with other settings.
    """
    return Study(path, store.open_file(path, settings))


def read_study(path: Path) -> Study:
    """The study in `path` as it is, whatever its settings. Raises InputError where there is none."""
    return Study(path, store.read_file(path))
