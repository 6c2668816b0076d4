"""The catalogue of effects (docs/reference/effects.md): a file here with an EFFECT is in it, and nothing else
registers it.

ALIKE alone names effects: what no log tells apart is a fact about two of them. An effect on the body changes what
plant/types.py can change.
"""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.base import parts
from tunefree_hil.base.contracts import Effect


class Alike(NamedTuple):
    """Effects that no log of an ordinary drive tells apart, where the field `without` is absent ('': always)."""

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
    """The names that count as this one for a vehicle without the fields `absent`; itself among them."""
    for alike in ALIKE:
        if name in alike.names and (not alike.without or alike.without in absent):
            return alike.names
    return frozenset({name})


__all__ = ["ALIKE", "Alike", "catalogue", "class_of"]
