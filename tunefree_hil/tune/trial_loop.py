"""The loop of the tuner: ask, evaluate, tell (paper, III-B and Fig. 6), in slots that survive a kill (design D13).

A trial fills a slot n of our own. Slots are asked in generations of `settings.in_flight`; the parameters of a slot
depend on the settings, n and the finished generations before it, and on nothing else. So a slot whose evaluation was
cut off is asked again and comes out the same: a study killed and resumed has the trials of one that was not, provided
that the evaluation is a function of its argument.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from tunefree_hil.base.errors import BenchError, TunefreeError
from tunefree_hil.tune.sampling import Told, suggest_some
from tunefree_hil.tune.store import Settings
from tunefree_hil.tune.trial import CUT_OFF, Evaluate, EvaluateAll, Evaluation, Trial, check

ASKED_AGAIN = 2  # times that one run asks a slot again after the bench failed
Points = Mapping[int, dict[str, float]]  # parameters by slot
Answers = Mapping[int, Evaluation | TunefreeError]  # what became of each slot


def points_of(settings: Settings, done: Sequence[Trial], slots: Sequence[int]) -> dict[int, dict[str, float]]:
    """What to try in `slots`, which all lie in one generation: a function of the settings and the generations before.

    `done`: filled slots in slot order; those of this generation and later ones do not count.
    """
    start = slots[0] // settings.in_flight * settings.in_flight
    history = [Told(trial.parameters, trial.score) for trial in done if trial.slot < start]
    points: dict[int, dict[str, float]] = {}
    if start == 0 and settings.first:
        points[0] = dict(settings.first)
    rest = range(start + len(points), slots[-1] + 1)  # all, also those before the slots: they are in flight with them
    if rest:
        drawn = suggest_some(
            settings.space,
            history,
            sampler=settings.sampler,
            seed=settings.seed,
            slots=rest,
            pending=list(points.values()),
        )
        points |= dict(zip(rest, drawn, strict=True))
    return {slot: points[slot] for slot in slots}


def next_slots(filled: set[int], in_flight: int, trials: int) -> list[int]:
    """The slots still to fill of the first generation that lacks one; empty when `trials` are filled."""
    for start in range(0, trials, in_flight):
        missing = [slot for slot in range(start, min(start + in_flight, trials)) if slot not in filled]
        if missing:
            return missing
    return []


class Filling(ABC):
    """A study that fills slots; where it is kept is the subclass's affair."""

    settings: Settings  # in_flight from 1 on

    @abstractmethod
    def trials(self) -> list[Trial]:
        """The filled slots, in slot order."""

    @abstractmethod
    def alone(self) -> AbstractContextManager[None]:
        """Hold the study for this process. Raises InputError when another one holds it."""

    @abstractmethod
    def begin(self, points: Points) -> Any:
        """These slots are being evaluated; what is returned is handed to `end`."""

    @abstractmethod
    def end(self, begun: Any, points: Points, answers: Answers) -> list[Trial]:
        """Keep what became of them, and give it as trials; those whose answer is an error with that error."""

    def run(self, trials: int, evaluate: Evaluate) -> Generator[Trial, None, None]:
        """`run_all` for an evaluation that takes one set of parameters by name."""
        return self.run_all(trials, lambda points: [evaluate(dict(values)) for values in points.values()])

    def run_all(self, trials: int, evaluate: EvaluateAll) -> Generator[Trial, None, None]:
        """Fill the slots up to `trials` in all; every attempt made is yielded, those that failed with their error.

        `evaluate` gets the parameters of the slots in flight. Raises BenchError when the bench failed a slot three
        times, and InputError when another process works on the study; the study stays good and can be run again. An
        interruption (Ctrl-C) goes through to the caller, after its slots were told FAIL.
        """
        with self.alone():
            done = {trial.slot: trial for trial in self.trials()}
            while slots := next_slots(set(done), self.settings.in_flight, trials):
                points = points_of(self.settings, [done[slot] for slot in sorted(done)], slots)
                for trial in (yield from self._fill(points, evaluate)):
                    done[trial.slot] = trial

    def _fill(self, points: Points, evaluate: EvaluateAll) -> Generator[Trial, None, list[Trial]]:
        """Yields the attempts at these slots and returns those that filled them."""
        filled: list[Trial] = []
        for attempt in range(1 + ASKED_AGAIN):
            answers = {}
            begun = self.begin(points)
            try:
                answers = _answers(points, evaluate)
            finally:
                if not answers:  # an interruption, or a bug: it goes through once FAIL was told
                    self.end(begun, points, dict.fromkeys(points, TunefreeError(CUT_OFF, code=CUT_OFF)))
            trials = self.end(begun, points, answers)
            yield from trials
            filled += [trial for trial in trials if not trial.error]
            problems = [answer for answer in answers.values() if isinstance(answer, TunefreeError)]
            if not problems:
                return filled
            if attempt == ASKED_AGAIN or not all(isinstance(problem, BenchError) for problem in problems):
                raise problems[0]
            points = {slot: values for slot, values in points.items() if isinstance(answers[slot], TunefreeError)}
        raise AssertionError("the last attempt returned or raised")


def _answers(points: Points, evaluate: EvaluateAll) -> dict[int, Evaluation | TunefreeError]:
    """The evaluation of each slot, or what went wrong with it."""
    try:
        evaluations = evaluate(points)
    except TunefreeError as problem:
        return dict.fromkeys(points, problem)
    return {slot: _judged(slot, one) for slot, one in zip(points, evaluations, strict=True)}


def _judged(slot: int, evaluation: Evaluation) -> Evaluation | TunefreeError:
    try:
        check(evaluation, f"slot {slot}")
    except TunefreeError as problem:
        return problem
    return evaluation
