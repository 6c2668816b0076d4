"""The smallest value of each effect that is named in 90 % of logs: from the logs of its bisection (row `limits`) and
those of the row `one`, whose sizes are drawn: ordinary and excited drives, of a person and of a controller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from tools.gap_exam.catalogue import EFFECTS, kind_of, size_of, value
from tools.gap_exam.ladder import GRID, effect_name, threshold
from tools.gap_exam.score import Marked

ROWS = ("limits", "one")


class Limit(NamedTuple):
    """value: named in 90 % of logs (alone and right) from there on; None where no size up to the gross one is.

    low, high: its 95 % interval, by size; None where that end lies beyond what can be said. at: the same three as
    sizes (0 just noticeable, 1 gross). steps: (size, value, named, logs).
    """

    name: str
    value: float | None
    low: float | None
    high: float | None
    unit: str
    n: int
    at: tuple[float, float, float]
    steps: tuple[tuple[float, float, int, int], ...]


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
    ends = (None if edge in (GRID[0], GRID[-1]) else amount(name, edge) for edge in (at.low, at.high))
    least = max(at.size, min(sizes))  # below what was asked nothing is said
    middle = amount(name, least) if any(named) and at.size <= 1.0 else None
    return Limit(name, middle, *ends, kind_of(name).unit, len(cases), tuple(at), steps)


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
