"""The loop of the tuner: ask, evaluate, tell (paper, III-B and Fig. 6), in slots that survive a kill (design D13).

A trial fills a slot n of our own. Its parameters depend on the settings, n and the finished slots before it, and on
nothing else; so a slot whose evaluation was cut off is told FAIL and asked again, and comes out the same. A study
killed and resumed therefore has the trials of one that was not, provided that `evaluate` is a function of its argument.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self

import optuna
from optuna.trial import FrozenTrial, TrialState

from tunefree_hil.base.errors import BenchError, TunefreeError
from tunefree_hil.tune import store
from tunefree_hil.tune.sampling import Told, learned_value, suggest
from tunefree_hil.tune.store import Settings

ASKED_AGAIN = 2  # times that one run asks a slot again after the bench failed
CUT_OFF = "interrupted"  # the error of an attempt that was cut off
_BASELINE = "baseline "


class Evaluation(NamedTuple):
    """What an evaluation says of one set of parameters. Lower is better; the score is finite and not negative.

    scenarios: by name, plain JSON data (score, metrics, replans, error names ...), kept as it is. error: not empty when
    the bench failed (a lost node); the score then does not count. Raising BenchError says the same.
    """

    score: float
    scenarios: dict[str, Any]
    error: str = ""


class Trial(NamedTuple):
    """One filled slot, or with `error` one attempt that failed (score NaN). `number` is Optuna's, and may run ahead."""

    slot: int
    number: int
    parameters: dict[str, float]
    score: float
    scenarios: dict[str, Any]
    error: str = ""


class Baseline(NamedTuple):
    """A set of parameters that was not searched for, scored beside the study and stored with it."""

    parameters: dict[str, float]
    score: float
    scenarios: dict[str, Any]


Evaluate = Callable[[dict[str, float]], Evaluation]


class Study:
    """A study in a file. Make it with `open_study` or `read_study`; close it, or use it in a `with`."""

    def __init__(self, path: Path, file: store.StudyFile) -> None:
        self.path = path
        self.settings: Settings = store.stored_settings(file.study)
        self.versions = store.versions_of(file.study)
        self._file = file
        self._optuna = file.study
        self._stored = {axis.name: axis.stored() for axis in self.settings.space.axes}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        store.close_file(self._file)

    def trials(self) -> list[Trial]:
        """The filled slots, in slot order."""
        found: dict[int, Trial] = {}
        for frozen in self._optuna.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)):
            trial = self._read(frozen)
            found.setdefault(trial.slot, trial)
        return [found[slot] for slot in sorted(found)]

    def failures(self) -> list[Trial]:
        """The attempts that failed, in the order in which they were made; error "interrupted" for those cut off."""
        return [self._read(frozen) for frozen in self._optuna.get_trials(deepcopy=False, states=(TrialState.FAIL,))]

    def best(self) -> Trial | None:
        """The trial of the lowest score, the earliest of equals; None before the first."""
        return min(self.trials(), key=lambda trial: trial.score, default=None)

    def add_baseline(self, name: str, parameters: Mapping[str, float], evaluation: Evaluation) -> None:
        """Store a baseline's score with the study. It is no trial: the sampler does not learn from it."""
        _check(evaluation, f"baseline {name}")
        data = {"parameters": dict(parameters), "score": evaluation.score, "scenarios": evaluation.scenarios}
        self._optuna.set_user_attr(_BASELINE + name, data)

    def baselines(self) -> dict[str, Baseline]:
        """The stored baselines by name."""
        attributes = self._optuna.user_attrs.items()
        return {key.removeprefix(_BASELINE): Baseline(**data) for key, data in attributes if key.startswith(_BASELINE)}

    def run(self, trials: int, evaluate: Evaluate) -> Generator[Trial, None, None]:
        """Fill the slots up to `trials` in all; every attempt made is yielded, those that failed with their error.

        `evaluate` gets the searched parameters by name. Raises BenchError when the bench failed a slot three times, and
        InputError when another process works on the study; the study stays good and can be run again. An interruption
        (Ctrl-C) goes through to the caller, after its slot was told FAIL.
        """
        with store.alone(self.path):
            self._tell_interrupted()
            done = self.trials()
            for slot in [slot for slot in range(trials) if slot not in {trial.slot for trial in done}]:
                filled = yield from self._fill(slot, done, evaluate)
                done = sorted([*done, filled], key=lambda trial: trial.slot)

    def _fill(self, slot: int, done: list[Trial], evaluate: Evaluate) -> Generator[Trial, None, Trial]:
        """Yields the attempts at one slot and returns the one that filled it."""
        parameters = self._parameters_of(slot, done)
        attempts = 0
        while True:
            asked = self._ask(slot, parameters)
            answer = self._answer(asked, parameters, evaluate)
            attempts += 1
            if isinstance(answer, Evaluation):
                trial = self._tell(asked, answer)
                yield trial
                return trial
            yield self._tell_failed(asked, f"{answer.code}: {answer.message}")
            if attempts > ASKED_AGAIN or not isinstance(answer, BenchError):
                raise answer

    def _answer(
        self, asked: optuna.Trial, parameters: dict[str, float], evaluate: Evaluate
    ) -> Evaluation | TunefreeError:
        """The evaluation, or what went wrong with it. An interruption, or a bug, goes through once FAIL was told."""
        cut_off = True
        try:
            evaluation = evaluate(dict(parameters))
            _check(evaluation, f"slot {asked.user_attrs['slot']}")
            cut_off = False
        except TunefreeError as problem:
            cut_off = False
            return problem
        finally:
            if cut_off:
                self._tell_failed(asked, CUT_OFF)
        return evaluation

    def _parameters_of(self, slot: int, done: list[Trial]) -> dict[str, float]:
        """What to try in `slot`: a function of the settings and the filled slots before it."""
        settings = self.settings
        if slot == 0 and settings.first:
            return dict(settings.first)
        history = [Told(trial.parameters, trial.score) for trial in done if trial.slot < slot]
        return suggest(settings.space, history, sampler=settings.sampler, seed=settings.seed, slot=slot)

    def _ask(self, slot: int, parameters: dict[str, float]) -> optuna.Trial:
        self._optuna.enqueue_trial(parameters, user_attrs={"slot": slot})
        return self._optuna.ask(self._stored)

    def _tell(self, asked: optuna.Trial, evaluation: Evaluation) -> Trial:
        asked.set_user_attr("score", float(evaluation.score))
        asked.set_user_attr("scenarios", evaluation.scenarios)
        return self._read(self._optuna.tell(asked, learned_value(evaluation.score)))

    def _tell_failed(self, asked: optuna.Trial, error: str) -> Trial:
        asked.set_user_attr("error", error)
        return self._read(self._optuna.tell(asked, state=TrialState.FAIL))

    def _tell_interrupted(self) -> None:
        """Tell FAIL what a process that is gone had asked for; without an `error` it reads as interrupted."""
        while self._optuna.get_trials(deepcopy=False, states=(TrialState.WAITING,)):
            self._optuna.ask()  # takes the waiting one: only a running trial can be told
        for frozen in self._optuna.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            self._optuna.tell(frozen.number, state=TrialState.FAIL)

    def _read(self, frozen: FrozenTrial) -> Trial:
        """Optuna's trial as ours. One that was killed while it was asked may lack parameters."""
        attributes = frozen.user_attrs
        failed = frozen.state == TrialState.FAIL
        return Trial(
            slot=attributes["slot"],
            number=frozen.number,
            parameters={name: frozen.params[name] for name in self._stored if name in frozen.params},
            score=math.nan if failed else attributes["score"],
            scenarios=attributes.get("scenarios", {}),
            error=attributes.get("error", CUT_OFF) if failed else "",
        )


def open_study(path: Path, settings: Settings) -> Study:
    """The study in `path` (`study.db` in the run folder), made if it is not there.

    Raises InputError, which names what differs, for a study that was started with other settings.
    """
    return Study(path, store.open_file(path, settings))


def read_study(path: Path) -> Study:
    """The study in `path` as it is, whatever its settings. Raises InputError where there is none."""
    return Study(path, store.read_file(path))


def _check(evaluation: Evaluation, of: str) -> None:
    """Raise BenchError where the bench failed, TunefreeError where the score is no score."""
    if evaluation.error:
        raise BenchError(evaluation.error, code="evaluation_failed")
    if not (math.isfinite(evaluation.score) and evaluation.score >= 0.0):
        raise TunefreeError(f"{of} was scored {evaluation.score}; a score is finite and not negative", code="bad_score")
