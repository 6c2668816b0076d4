"""The smallest value of each effect that is named in 90 % of logs: from the logs of its bisection (row `limits`) and
those of the row `one`, whose sizes are drawn: ordinary and excited drives, of a person and of a controller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from tools.gap_exam.catalogue import EFFECTS, kind_of, size_of, value
from tools.gap_exam.ladder import effect_name, threshold
from tools.gap_exam.score import Marked

ROWS, EXCITED = ("limits", "one"), "excited"


class Limit(NamedTuple):
    """value: named in 90 % of logs (alone and right) from there on; None where not even the largest size asked is.

    low, high: its 95 % interval, by size; None (open) where that end lies outside of the sizes asked: nothing was
    measured there. or_less: all that was asked is named, so that `value` is the smallest size asked and the limit is
    there or below. at: value, low, high as sizes (0 just noticeable, 1 gross), each drawn to the sizes asked. steps:
    (size, value, named, logs). excited: the value by the excited drives alone, as all of the bisection are; half of the
    others are ordinary, where an effect may never show, however large.
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
    or_less: bool = False
    excited_or_less: bool = False


class _Seen(NamedTuple):
    """A limit as sizes: it and its interval, drawn to the sizes asked; whether an end lies outside of those (open);
    whether it is reached at all; whether it is the smallest size asked, or less."""

    at: tuple[float, float, float]
    opens: tuple[bool, bool]
    reached: bool
    or_less: bool


def limits(cases: Sequence[Marked]) -> list[Limit]:
    """Of every effect of which a bisection was begun."""
    found = []
    for name in EFFECTS:
        of = [one for one in cases if one.truth["row"] in ROWS and effect_name(one.truth["effects"]) == name]
        if any(one.truth["row"] == "limits" for one in of):
            found.append(_limit(name, of))
    return found


def _limit(name: str, cases: Sequence[Marked]) -> Limit:
    sizes, seen = [_size(name, one.truth) for one in cases], _seen(name, cases)
    named = [one.mark.outcome == "right" for one in cases]
    hits = {size: sum(hit for s, hit in zip(sizes, named, strict=True) if s == size) for size in sorted(set(sizes))}
    steps = tuple((size, amount(name, size), hit, sizes.count(size)) for size, hit in hits.items())
    ends = zip(seen.at[1:], seen.opens, strict=True)
    low, high = (None if is_open else amount(name, edge) for edge, is_open in ends)
    excited = _seen(name, [one for one in cases if one.truth["kind"] == EXCITED])
    return Limit(name, _value(name, seen), low, high, kind_of(name).unit, len(cases), seen.at, steps,
                 _value(name, excited), seen.or_less, excited.or_less)  # fmt: skip


def _seen(name: str, cases: Sequence[Marked]) -> _Seen:
    """The limit that some of the cases say."""
    sizes = [_size(name, one.truth) for one in cases]
    named = [one.mark.outcome == "right" for one in cases]
    found, least, most = threshold(sizes, named), min(sizes, default=0.0), max(sizes, default=1.0)
    or_less = bool(named) and (all(named) or found.size <= least)
    at = (least if or_less else found.size, found.low, found.high)
    size, low, high = (min(max(one, least), most) for one in at)
    # Of what is named wherever it was asked the upper end lies at the smallest size, if not above
    opens = (or_less or not least <= found.low <= most, found.high > most)
    return _Seen((size, low, high), opens, any(named) and found.size <= most, or_less)


def _value(name: str, seen: _Seen) -> float | None:
    return amount(name, seen.at[0]) if seen.reached else None


def _size(name: str, truth: Mapping[str, Any]) -> float:
    """As it was asked for by a bisection, else of the value that was drawn."""
    if truth["size"] >= 0.0:
        return float(truth["size"])
    return size_of(name, truth["effects"][name][kind_of(name).parameter])


def amount(name: str, size: float) -> float:
    """The value that a reader means: of a gain how far it is from 1, of anything else the parameter itself."""
    kind = kind_of(name)
    if kind.way == "factor":
        return kind.small * (kind.large / kind.small) ** size
    return value(name, size)


def is_less_worse(name: str) -> bool:
    """Whether a smaller value is a grosser effect: rates, powers, angles and friction that something is limited to."""
    return kind_of(name).way in ("limit", "less")
