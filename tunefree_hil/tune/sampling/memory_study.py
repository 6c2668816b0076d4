"""Optuna studies in memory, from which Optuna's samplers learn.

The sampler does not get the study file, because its content depends on kills. A kill leaves a RUNNING, later a FAIL
trial, so all later trials have a higher number. TPE orders its kernels by that number (which affects their weights, and
ties between equal scores) and keeps away from RUNNING trials. So the sampler gets a study in memory, which holds the
finished slots in slot order; only trials in flight are unfinished.

Making this study anew for each suggestion costs more than the suggestion. So the last studies are remembered, and one
whose history begins the present one is extended. Trials in flight are ended as FAIL after the suggestion. No sampler
looks at these, and the order of the others is that of the slots, so a suggestion is still a function of its arguments.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseGASampler, BaseSampler, RandomSampler
from optuna.study import StudyDirection
from optuna.trial import TrialState, create_trial

from tunefree_hil.tune.sampling.points import ScoredPoint, sampler_value_from_score
from tunefree_hil.tune.space import Space

# Otherwise Optuna prints "A new study created" for every study, and advice to install a package for its GP.
optuna.logging.set_verbosity(optuna.logging.ERROR)

CONSTRAINT = "requirements"  # name of the only constraint
MOST_STUDIES = 4  # remembered: a search, and some beside it in the same process
MOST_RETRACTED = 100  # trials ended as FAIL, beyond the number of finished ones: they cost time, so begin anew


class StudyKind(NamedTuple):
    """Studies of the same kind can hold the same trials.

    objectives: Number of objectives, 1 for the score.
    replayed: Each trial was asked for and told in turn, so that a genetic sampler has stored its generation.
    """

    space: Space
    objectives: int
    replayed: bool = False


class MemoryStudy:
    """A study in memory with the finished trials `history`."""

    def __init__(self, kind: StudyKind, genetic: BaseGASampler | None = None) -> None:
        self.kind = kind
        self.history: list[ScoredPoint] = []
        self.distributions = {axis.name: axis.sampler_distribution() for axis in kind.space.axes}
        directions = [StudyDirection.MINIMIZE] * kind.objectives
        self._study = optuna.create_study(directions=directions, sampler=RandomSampler(seed=0))
        self._genetic = genetic
        self._unfinished: list[int] = []
        self._retracted = 0

    @property
    def is_worn(self) -> bool:
        """Whether so many trials were retracted that a new study is faster."""
        return self._retracted > len(self.history) + MOST_RETRACTED

    def begins(self, history: Sequence[ScoredPoint]) -> bool:
        """Whether `history` begins with the trials of this study."""
        return len(self.history) <= len(history) and self.history == list(history[: len(self.history)])

    def extend(self, points: Iterable[ScoredPoint]) -> None:
        """Add finished trials."""
        for point in points:
            if self._genetic is None:
                self._add(point)
            else:
                self._replay(point, self._genetic)
            self.history.append(point._replace(parameters=dict(point.parameters)))

    def begin(self, parameters: Mapping[str, float]) -> None:
        """Begin a trial with these parameters, which is in flight."""
        self._study.sampler = RandomSampler(seed=0)
        self._study.enqueue_trial(self._sampler_values(parameters))
        self._unfinished.append(self._study.ask(self.distributions).number)

    def ask(self, sampler: BaseSampler) -> dict[str, float]:
        """Begin a trial with parameters that `sampler` suggests, and return them."""
        self._study.sampler = sampler
        trial = self._study.ask(self.distributions)
        self._unfinished.append(trial.number)
        return {axis.name: axis.from_sampler(trial.params[axis.name]) for axis in self.kind.space.axes}

    def retract(self) -> None:
        """End all trials in flight, so that no later suggestion knows them."""
        self._study.sampler = RandomSampler(seed=0)
        for number in self._unfinished:
            self._study.tell(number, state=TrialState.FAIL)
        self._retracted += len(self._unfinished)
        self._unfinished.clear()

    def _add(self, point: ScoredPoint) -> None:
        trial = create_trial(
            params=self._sampler_values(point.parameters),
            distributions=self.distributions,
            values=self._values(point),
            # A sampler ranks trials without a violation first, by score, then the others by their violation.
            constraints=None if point.violation is None else {CONSTRAINT: point.violation},
        )
        self._study.add_trial(trial)

    def _replay(self, point: ScoredPoint, genetic: BaseGASampler) -> None:
        self._study.enqueue_trial(self._sampler_values(point.parameters))
        trial = self._study.ask(self.distributions)
        genetic.get_trial_generation(self._study, self._study.get_trials(deepcopy=False)[-1])  # stores it, too
        if point.violation is not None:
            trial.set_constraint(CONSTRAINT, point.violation)
        self._study.tell(trial, self._values(point))

    def _values(self, point: ScoredPoint) -> list[float]:
        return [sampler_value_from_score(value) for value in point.objectives or (point.score,)]

    def _sampler_values(self, parameters: Mapping[str, float]) -> dict[str, float | int]:
        return {axis.name: axis.to_sampler(parameters[axis.name]) for axis in self.kind.space.axes}


class StudyMemory:
    """The last studies, the latest at the end."""

    def __init__(self) -> None:
        self._studies: list[MemoryStudy] = []
        self._lock = threading.Lock()

    def forget(self) -> None:
        """Forget all studies."""
        with self._lock:
            self._studies.clear()

    @contextmanager
    def open(
        self, kind: StudyKind, history: Sequence[ScoredPoint], genetic: BaseGASampler | None = None
    ) -> Iterator[MemoryStudy]:
        """A study with these finished trials and none in flight; after an error it is not used again.

        Args:
            kind: Kind of the study.
            history: Finished trials in slot order.
            genetic: A sampler of the kind that learns from `replayed` trials.
        """
        study = self._take(kind, history) or MemoryStudy(kind, genetic)
        study.extend(history[len(study.history) :])
        yield study
        study.retract()
        if not study.is_worn:
            with self._lock:
                self._studies = [*self._studies, study][-MOST_STUDIES:]

    def _take(self, kind: StudyKind, history: Sequence[ScoredPoint]) -> MemoryStudy | None:
        """Remove the study with the longest beginning of `history`; None where there is none."""
        with self._lock:
            fitting = [study for study in self._studies if study.kind == kind and study.begins(history)]
            longest = max(fitting, key=lambda study: len(study.history), default=None)
            self._studies = [study for study in self._studies if study is not longest]
            return longest


def list_searched(distributions: Mapping[str, BaseDistribution]) -> dict[str, BaseDistribution]:
    """The distributions with more than one value, by name, in the order in which Optuna gives them to samplers."""
    return {name: distributions[name] for name in sorted(distributions) if not distributions[name].single()}
