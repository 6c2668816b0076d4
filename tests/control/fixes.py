"""Fixes that a follower is fed in its tests, and a straight course to feed them on."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tunefree_hil.base.course import Course, Tracking
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import Ins

DT_S = 0.01
AHEAD_M = 1.4224


def run(block: Block, fixes: Iterable[Ins], first: int = 0) -> list[Tracking]:
    """Trackings of consecutive fixes."""
    state, answers = block.init(block.params, DT_S), []
    for k, ins in enumerate(fixes, first):
        state, tracking = block.step(block.params, state, (k, ins), DT_S)
        answers.append(tracking)
    return answers


def straight(kit: Any, seconds: float = 20.0, speed: float = 5.0) -> Course:
    """Straight on at one speed; `kit`: the fixture."""
    return kit.course(seconds, lambda t: speed)


def fix(x: float = 0.0, y: float = 0.0, heading: float = 0.0, speed: float = 5.0, yaw_rate: float = 0.0) -> Ins:
    """One INS record without acceleration."""
    return Ins(x, y, heading, speed, 0.0, yaw_rate)
