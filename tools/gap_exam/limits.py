"""The smallest value of each effect that is named in 90 % of logs: from the logs of its bisection (row `limits`) and
those of the row `one`, whose sizes are drawn: ordinary and excited drives, of a person and of a controller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from tools.gap_exam.catalogue import EFFECTS, kind_of, size_of, value
from tools.gap_exam.ladder import GRID, effect_name, threshold
from tools.gap_exam.score import Marked

ROWS, EXCITED = ("limits", "one"), "excited"


class Limit(NamedTuple):
    """value: named in 90 % of logs (alone and right) from there on; None where no size up to the gross one is.

    low, high: its 95 % interval, by size; None where that end lies beyond what can be said. at: the same three as
    sizes (0 just noticeable, 1 gross). steps: (size, value, named, logs). excited: the value by the excited drives
    alone, as all of the bisection are; half of the others are ordinary, where an effect may never show, however large.
    """

    name: str
    value: float | None
    low: float | None
    high: float | None
    unit: str
    n: int
    at: tuple[float, float, float]
    steps: tuple[tuple[float, float, int, int], ...]
    excited: float | None = None


def limits(cases: Sequence[Marked]) -> list[Limit]:
    """Of every effect of which a bisection was begun."""
    found = []
    for name in EFFECTS:
        of = [one for one in cases if one.truth["row"] in ROWS and effect_name(one.truth["effects"]) == name]
        if any(one.truth["row"] == "limits" for one in of):
            found.append(_limit(name, of))
    return found


def _limit(name: str, cases: Sequence[Marked]) -> Limit:
    sizes = [_size(name, one.truth) for one in cases]
    named = [one.mark.outcome == "right" for one in cases]
    at = threshold(sizes, named)
    hits = {size: sum(hit for s, hit in zip(sizes, named, strict=True) if s == size) for size in sorted(set(sizes))}
    steps = tuple((size, amount(name, size), hit, sizes.count(size)) for size, hit in hits.items())
    low, high = (None if edge in (GRID[0], GRID[-1]) else amount(name, edge) for edge in (at.low, at.high))
    middle = _value(name, cases)
    excited = _value(name, [one for one in cases if one.truth["kind"] == EXCITED])
    unit, three = kind_of(name).unit, (at.size, at.low, at.high)
    return Limit(name, middle, low, high, unit, len(cases), three, steps, excited)


def _value(name: str, cases: Sequence[Marked]) -> float | None:
    """The limit that some of the cases say."""
    sizes = [_size(name, one.truth) for one in cases]
    named = [one.mark.outcome == "right" for one in cases]
    size = threshold(sizes, named).size
    least = max(size, min(sizes, default=size))  # below what was asked nothing is said
    return amount(name, least) if any(named) and size <= 1.0 else None


def _size(name: str, truth: Mapping[str, Any]) -> float:
    """As it was asked for by a bisection, else of the value that was drawn."""
    if truth["size"] >= 0.0:
        return float(truth["size"])
    return size_of(name, truth["effects"][name][kind_of(name).parameter])


def amount(name: str, size: float) -> float:
    """The value that a reader means: of a gain how far it is from 1, of a limit the limit."""
    kind = kind_of(name)
    if kind.way in ("factor", "less"):
        return kind.small * (kind.large / kind.small) ** size
    return value(name, size)
