"""The loop of the tuner: suggest, evaluate, store (paper, III-B and Fig. 6), in slots that survive a kill.

A trial fills a slot; slots are numbered independently of Optuna. They are suggested in generations of
`settings.in_flight`; the parameters of a slot depend only on the settings, its number and the generations before it. A
slot whose evaluation was cut off is suggested again with the same parameters. So a resumed study has the same trials as
one that was not killed, provided that the evaluation depends on its argument alone.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

from tunefree_hil.base.errors import BenchError, TunefreeError
from tunefree_hil.tune.sampling import ScoredPoint, suggest_points
from tunefree_hil.tune.sampling.records import find_record
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.trial import INTERRUPTED, Evaluate, EvaluateAll, Evaluation, Trial, check_evaluation

MAX_RETRIES = 2  # of a slot within one run, after the bench failed
Points = Mapping[int, dict[str, float]]  # parameters by slot
Outcomes = Mapping[int, Evaluation | TunefreeError]  # by slot


class SlotStudy(Protocol):
    """A study whose slots `run_trials` fills, wherever it is stored."""

    settings: StudySettings  # in_flight is 1 or more

    def trials(self) -> list[Trial]:
        """The filled slots, in slot order."""
        ...

    def lock(self) -> AbstractContextManager[None]:
        """Lock the study for this process. Raises InputError where another process works on it."""
        ...

    def begin(self, points: Points) -> Any:
        """Store that these slots are being evaluated; the returned value is passed to `end`."""
        ...

    def end(self, begun: Any, points: Points, outcomes: Outcomes) -> list[Trial]:
        """Store the outcomes and return them as trials, failed ones with their error."""
        ...


def suggest_slots(settings: StudySettings, done: Sequence[Trial], slots: Sequence[int]) -> dict[int, dict[str, float]]:
    """Suggest the parameters of `slots`, a function of the settings and the earlier generations only.

    Args:
        settings: Settings of the study.
        done: Filled slots in slot order; those of this generation and of later ones are ignored.
        slots: Slots of one generation, ascending.
    """
    start = slots[0] // settings.in_flight * settings.in_flight
    history = [point_from_trial(trial, settings) for trial in done if trial.slot < start]
    points = dict(list(enumerate(settings.given_points))[start : slots[-1] + 1])
    # All slots of the generation up to the last one: the earlier ones are in flight with them.
    remaining = range(start + len(points), slots[-1] + 1)
    if remaining:
        suggested = suggest_points(
            settings.space,
            history,
            sampler=settings.sampler,
            seed=settings.seed,
            slots=remaining,
            pending=list(points.values()),
            kappa_w=settings.kappa_w,
            given=len(settings.given_points),
        )
        points |= dict(zip(remaining, suggested, strict=True))
    return {slot: points[slot] for slot in slots}


def point_from_trial(trial: Trial, settings: StudySettings) -> ScoredPoint:
    """What a sampler learns from a trial. One that searches a single value gets the trade of several objectives."""
    violation = trial.violation if settings.requirements else None
    objectives = trial.objectives if find_record(settings.sampler).objectives else ()
    return ScoredPoint(trial.parameters, trial.merit, violation, objectives)


def find_next_slots(filled: set[int], in_flight: int, trials: int) -> list[int]:
    """The free slots of the first generation that is not full; empty when `trials` slots are filled."""
    for start in range(0, trials, in_flight):
        missing = [slot for slot in range(start, min(start + in_flight, trials)) if slot not in filled]
        if missing:
            return missing
    return []


def run_trials(study: SlotStudy, trials: int, evaluate: Evaluate) -> Generator[Trial, None, None]:
    """`run_generations` for an evaluation that takes one set of parameters."""
    return run_generations(study, trials, lambda points: [evaluate(dict(values)) for values in points.values()])


def run_generations(study: SlotStudy, trials: int, evaluate: EvaluateAll) -> Generator[Trial, None, None]:
    """Fill the slots of a study; yields every attempt, failed ones with their error.

    An interruption (Ctrl-C) is passed on after its slots were stored as failed.

    Args:
        study: The study, locked during the search.
        trials: Number of slots to fill in all, earlier runs included.
        evaluate: Scores the parameters of the slots in flight.

    Raises:
        BenchError: The bench failed one slot three times. The study stays valid and can be run again.
        InputError: Another process works on the study.
    """
    with study.lock():
        done = {trial.slot: trial for trial in study.trials()}
        while slots := find_next_slots(set(done), study.settings.in_flight, trials):
            points = suggest_slots(study.settings, [done[slot] for slot in sorted(done)], slots)
            for trial in (yield from _fill_slots(study, points, evaluate)):
                done[trial.slot] = trial


def _fill_slots(study: SlotStudy, points: Points, evaluate: EvaluateAll) -> Generator[Trial, None, list[Trial]]:
    """Yield the attempts at these slots; returns those that filled them."""
    filled: list[Trial] = []
    for attempt in range(1 + MAX_RETRIES):
        outcomes = {}
        begun = study.begin(points)
        try:
            outcomes = _evaluate_points(points, evaluate)
        finally:
            if not outcomes:  # an interruption or a bug, which is passed on once the slots are stored as failed
                study.end(begun, points, dict.fromkeys(points, TunefreeError(INTERRUPTED, code=INTERRUPTED)))
        trials = study.end(begun, points, outcomes)
        yield from trials
        filled += [trial for trial in trials if not trial.error]
        errors = [outcome for outcome in outcomes.values() if isinstance(outcome, TunefreeError)]
        if not errors:
            return filled
        if attempt == MAX_RETRIES or not all(isinstance(error, BenchError) for error in errors):
            raise errors[0]
        points = {slot: values for slot, values in points.items() if isinstance(outcomes[slot], TunefreeError)}
    raise AssertionError("the last attempt returned or raised")


def _evaluate_points(points: Points, evaluate: EvaluateAll) -> dict[int, Evaluation | TunefreeError]:
    """The evaluation of each slot, or its error."""
    try:
        evaluations = evaluate(points)
    except TunefreeError as error:
        return dict.fromkeys(points, error)
    return {slot: _checked(slot, evaluation) for slot, evaluation in zip(points, evaluations, strict=True)}


def _checked(slot: int, evaluation: Evaluation) -> Evaluation | TunefreeError:
    try:
        check_evaluation(evaluation, f"slot {slot}")
    except TunefreeError as error:
        return error
    return evaluation
