"""The catalogue of effects (docs/reference/effects.md): every file here with an EFFECT belongs to it.

Only ALIKE names effects, as it concerns pairs of them. An effect on the body changes fields of BodyChange.
"""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.base import parts
from tunefree_hil.base.contracts import Effect


class Alike(NamedTuple):
    """Effects that a log of an ordinary drive cannot distinguish, where the field `without` is absent ('': always)."""

    names: frozenset[str]
    without: str = ""


ALIKE = (
    Alike(frozenset({"brake_drag", "rolling_resistance"})),
    Alike(frozenset({"side_wind", "road_bank"}), "report.lateral_accel_mps2"),
)


def catalogue() -> dict[str, Effect]:
    """Every effect of the folder, by name."""
    return {name: parts.load(__name__, name, "EFFECT") for name in parts.names(__name__)}


def class_of(name: str, absent: frozenset[str] = frozenset()) -> frozenset[str]:
    """The names that are equivalent to this one for a vehicle without the fields `absent`, itself included."""
    for alike in ALIKE:
        if name in alike.names and (not alike.without or alike.without in absent):
            return alike.names
    return frozenset({name})


__all__ = ["ALIKE", "Alike", "catalogue", "class_of"]
