"""Where simulation and measurement part: every link by itself, before anybody is suspected.

A link is broken where more is left of it than recalibration takes away, than noise, and than a calibrated model may
miss: what could be explained by *something* on blocks that were not fitted on (leftover.py). A card says it in words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.bursts import BLOCKS, Burst
from tunefree_hil.gap.clock import Echo
from tunefree_hil.gap.leftover import Left
from tunefree_hil.gap.regions import Region
from tunefree_hil.gap.shape import Shape
from tunefree_hil.gap.work import Kind

LEAST_SHARE = 0.05  # of a target's mean square that something could explain
VISIBLE = 0.03  # of the signal: what a calibrated model may miss of a car
# Where its own calibration missed more of drives that it was not fitted on, that; but a model that misses twice as much
# as others do lacks something itself
MOST_VISIBLE = 0.06
LOUD = 0.15  # of the signal, in the loudest moments: of cars with other tyres and pedals up to 0.13 is missed
# Of the signal, beyond the sensor's noise and far above it (squares): so much is missed of no car that anybody has
# calibrated, whether it can be foretold or not
GROSS, FAR = 0.25, 10.0
NO_BURSTS: Mapping[str, Burst] = {}


class Looked(NamedTuple):
    """One target of a link with recalibration done. rms: left; noise: of it what nothing explains; explicable: what
    something could, and as a share of the signal it is about. loud: what the loudest moments miss of the signal, where
    they are far above the ordinary (gap/bursts.py); else 0. visible: of the signal, what no link is broken by.
    """

    signal: str
    link: Link
    unit: str
    rms: float
    noise: float
    explicable: float
    share: float
    broken: bool
    loud: float = 0.0
    visible: float = VISIBLE
    gross: float = 0.0

    @property
    def missed(self) -> str:
        """What is broken about it, in words."""
        if self.loud > LOUD:
            return f"{self.signal} is missed by {self.loud:.0%} of the signal in moments, and hardly else"
        if self.gross > max(GROSS, self.share):
            return (
                f"{self.signal} is missed by {self.gross:.0%} of the signal, and little of that is foretold by anything"
            )
        return f"{self.signal} is missed by {self.share:.1%}"

    @property
    def amount(self) -> float:
        """Of the signal, what is missed: what could be explained, what its moments miss where they are loud, or all
        where that is gross.
        """
        return max(self.share, self.loud if self.loud > LOUD else 0.0, self.gross if self.gross > GROSS else 0.0)


class Card(NamedTuple):
    """A broken target in words, with its shape and the regions it was looked at in, those that stand out first."""

    looked: Looked
    shape: Shape | None
    regions: tuple[Region, ...]
    words: str


def look(
    left: Mapping[str, Left], kinds: Mapping[str, Kind], sizes: Mapping[str, float],
    bursts: Mapping[str, Burst] = NO_BURSTS,
) -> list[Looked]:  # fmt: skip
    """All targets, the one that is missed most of its signal first. Broken is what could be explained, is loud, or is
    gross; of a yaw rate that wheels tell only the first, as a bump in the road is loud in it.
    """
    found = []
    for name, one in left.items():
        explicable = max(one.explained, 0.0)
        share = explicable**0.5 / max(sizes[name], 1e-12)
        kind = kinds[name]
        blocks = 1 if kind.link is Link.COMMAND_TO_REPORT else BLOCKS
        loud = bursts[name].share(sizes[name], blocks) if name in bursts and not kind.by_wheels else 0.0
        visible = min(max(VISIBLE, kind.missed / max(sizes[name], 1e-12)), MOST_VISIBLE)
        far = one.total > FAR * kind.noise**2 and not kind.by_wheels
        beyond = one.total - kind.noise**2 if far else 0.0
        gross = beyond**0.5 / max(sizes[name], 1e-12)
        broken = loud > LOUD or gross > GROSS or (share > visible and explicable > LEAST_SHARE * one.total)
        noise = max(one.total - explicable, 0.0) ** 0.5
        found.append(
            Looked(
                name, kind.link, kind.unit, one.total**0.5, noise, explicable**0.5, share, broken, loud, visible, gross
            )
        )  # fmt: skip
    return sorted(found, key=lambda one: (not one.broken, -one.amount))


def card(looked: Looked, shape: Shape | None, regions: Sequence[Region], size: float) -> Card:
    """'brake (command_to_report), brake (duty) 0.15 to 0.22, 0.31 s late'."""
    clear = [one.words for one in regions if one.stands_out][:2]
    said = [] if shape is None else [shape.words(size)]
    words = ", ".join([f"{looked.signal} ({looked.link.value})", *clear, *(one for one in said if one)])
    return Card(looked, shape, tuple(regions), words)


def echo_words(echoes: Sequence[Echo]) -> list[str]:
    """What is wrong with the way of commands from the wire to the by-wire unit."""
    return [
        f"{one.strange:.1%} of the {one.channel} commands echoed were not sent at that time: frames are lost or changed"
        for one in echoes
        if one.broken
    ]
