"""Problems of logs for learning, and the refusal of logs with such problems."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

from tunefree_hil.base.errors import InputError

Severity = Literal["refuse", "warn"]


class LogProblem(NamedTuple):
    """One problem. drive and field: its place, '' for all drives or fields."""

    severity: Severity
    code: str  # a constant word for machines
    drive: str
    field: str
    message: str  # one sentence with the log, the field, what is expected, and what to do
    file: str = ""  # the log as the user named it


def raise_refusals(problems: Iterable[LogProblem]) -> list[LogProblem]:
    """The problems, if all of them are warnings.

    Raises:
        InputError: with the messages of all refusals.
    """
    problems = list(problems)
    refusals = [problem for problem in problems if problem.severity == "refuse"]
    if not refusals:
        return problems
    first = refusals[0]
    listed = "\n".join(f"  {refusal.message}" for refusal in refusals)
    count = "1 problem" if len(refusals) == 1 else f"{len(refusals)} problems"
    raise InputError(
        f"these logs cannot be used because of {count}:\n{listed}",
        code=first.code,
        file=first.file or first.drive,
        key=first.field,
        hint="correct these problems, or leave the log out",
    )
