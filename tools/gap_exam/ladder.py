"""How small an effect may be and still be named: every effect's sizes by bisection, as its answers come in.

Three rounds of three logs, each log another vehicle: the first at the middle of the sizes; then half a step down where
all three were named (alone and right), else half a step up. The rule is fixed before the exam, sizes are not; a truth
is sealed as any other before its question is asked.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tools.gap_exam.cases import Case, draw_effect
from tools.gap_exam.catalogue import EFFECTS
from tools.gap_exam.files import Run, read_json
from tools.gap_exam.outcomes import outcome
from tools.gap_exam.rows import PER_ROUND, ROUNDS, Exam
from tools.gap_exam.seal import open_truth

LEAST_NAMED = 0.9
FIRST_STEP = 0.3  # in three rounds from 0.05 to 0.95: nearly all of what is between just noticeable and gross
GRID = np.linspace(-0.4, 1.6, 201)  # of the size that is named in 90 % of logs
SPREADS = np.geomspace(0.01, 0.15, 20)  # how gradually names come: to 90 % from 50 % it is 2.2 times that


class Ladder:
    """The cases of the row `limits` by effect and round."""

    def __init__(self, exam: Exam) -> None:
        self.exam = exam
        self._cases: dict[str, list[list[Case]]] = {name: [[] for _ in range(ROUNDS)] for name in EFFECTS}
        for case in exam.cases:
            if case.rung >= 0:
                self._cases[effect_of(case)][case.rung].append(case)

    def waits(self, run: Run, case: Case) -> bool:
        """Whether a case's size hangs on answers that are not there yet."""
        return any(not run.is_answered(one.number) for one in self._before(case))

    def sized(self, run: Run, case: Case) -> Case:
        """The case with the size that the rounds before it ask for; any other case as it is."""
        if case.rung < 0:
            return case
        earlier = self._cases[effect_of(case)][: case.rung]
        size = next_size([[was_named(run, one.number) for one in some] for some in earlier])
        return at_size(self.exam, case, size)

    def _before(self, case: Case) -> list[Case]:
        if case.rung < 0:
            return []
        return [one for some in self._cases[effect_of(case)][: case.rung] for one in some]


def effect_of(case: Case) -> str:
    """The one effect that is asked for."""
    return effect_name(case.effects)


def effect_name(effects: Mapping[str, Any]) -> str:
    """The name of the first of some effects."""
    return next(iter(effects))


def next_size(rounds: Sequence[Sequence[bool]]) -> float:
    """The size of the next round, by what was named in those before."""
    size, step = 0.5, FIRST_STEP
    for named in rounds:
        size += -step if all(named) else step
        step /= 2.0
    return size


def at_size(exam: Exam, case: Case, size: float) -> Case:
    """A case of the row at another size; its sign and its second parameter stay."""
    name = effect_of(case)
    draw = exam.domain.rng("effect", name, "limits", case.rung * PER_ROUND + case.place)
    return case._replace(size=size, effects={name: draw_effect(name, draw, size)})


def was_named(run: Run, number: int) -> bool:
    """Whether an answered case was named, alone and right."""
    path = run.answer(number) / "gap.json"
    truth = open_truth(run, number)
    return outcome(list(truth["effects"]), read_json(path) if path.is_file() else None) == "right"


class Threshold(NamedTuple):
    """The size that is named in 90 % of logs, with its 95 % interval."""

    size: float
    low: float
    high: float


def threshold(sizes: Sequence[float], named: Sequence[bool]) -> Threshold:
    """By the logistic curve through all logs, over an even prior of its place and spread: median and 2.5 to 97.5 %."""
    at, spread = np.meshgrid(GRID, SPREADS, indexing="ij")
    lift = math.log(LEAST_NAMED / (1.0 - LEAST_NAMED))
    log = np.zeros_like(at)
    for size, hit in zip(sizes, named, strict=True):
        along = np.clip((size - at) / spread + lift, -30.0, 30.0)
        log += -np.log1p(np.exp(-along if hit else along))
    weight = np.exp(log - log.max()).sum(axis=1)
    share = np.cumsum(weight) / weight.sum()
    low, middle, high = (float(GRID[np.searchsorted(share, q)]) for q in (0.025, 0.5, 0.975))
    return Threshold(middle, low, high)
