"""What may be wrong with logs that something is to be learned from: in words, and whether it forbids learning."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

from tunefree_hil.base.errors import InputError

Severity = Literal["refuse", "warn"]


class Problem(NamedTuple):
    """One thing that is wrong. code: a constant word for machines; drive, field: where ('' where it is all of them).

    words: one sentence with the log, the field, what was expected and what to do. file: that log as it was given.
    """

    severity: Severity
    code: str
    drive: str
    field: str
    words: str
    file: str = ""


def require_good(problems: Iterable[Problem]) -> list[Problem]:
    """The warnings among them. Raises one InputError with the words of all refusals."""
    problems = list(problems)
    refusals = [one for one in problems if one.severity == "refuse"]
    if not refusals:
        return problems
    first = refusals[0]
    listed = "\n".join(f"  {one.words}" for one in refusals)
    count = "1 thing is" if len(refusals) == 1 else f"{len(refusals)} things are"
    raise InputError(
        f"nothing is done with these logs, {count} wrong:\n{listed}",
        code=first.code,
        file=first.file or first.drive,
        key=first.field,
        hint="mend what is named, or leave the log out",
    )
