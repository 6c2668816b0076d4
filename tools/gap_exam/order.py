"""In which order an exam's cases are asked: rows side by side, so that a run that is cut off has some of every row.

A row's cases come in a seeded order, spread evenly over the exam; the headline row is done at half of it, and all
others before the last rounds of the bisections. Cases that share a learned model, or a round, stay together.
"""

from __future__ import annotations

from tools.gap_exam.cases import Case
from tools.gap_exam.catalogue import EFFECTS
from tools.gap_exam.ladder import effect_of
from tools.gap_exam.rows import Exam

WEIGHT = {"one": 2.0, "free": 1.4, "semi_free": 2.0, "limits": 1.0}  # the sooner a row is done
OTHERS = 1.2
BY_MODEL = ("start_b", "start_c", "start_d")


def in_order(exam: Exam) -> list[Case]:
    """All cases, the first to be asked first."""
    keyed = []
    for row in sorted({case.row for case in exam.cases}):
        mine = [case for case in exam.cases if case.row == row]
        for k, case in enumerate(_within(exam, row, mine)):
            keyed.append(((k + 0.5) / len(mine) / WEIGHT.get(row, OTHERS), case.number, case))
    return [case for _, _, case in sorted(keyed, key=lambda one: one[:2])]


def _within(exam: Exam, row: str, cases: list[Case]) -> list[Case]:
    turn = exam.domain.rng("asked", row).permutation(len(cases))
    mixed = [cases[i] for i in turn]
    if row in BY_MODEL:
        return sorted(mixed, key=lambda case: case.model)
    return sorted(mixed, key=lambda case: case.rung)


def part_of(case: Case, parts: int) -> int:
    """The part, from 0, that a case belongs to: an effect's bisection is one part's alone."""
    return list(EFFECTS).index(effect_of(case)) % parts if case.rung >= 0 else case.number % parts
