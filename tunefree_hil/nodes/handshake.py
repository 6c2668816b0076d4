"""Taking over a by-wire vehicle: the controller's side of enable, clear and override (apollo_facts 7.3).

    WAIT ── nothing latched ──> ENABLING ── every channel says enabled ──> ENGAGED ── override, fault, dropped ──> LOST
      └── override latched ──> CLEARING ──┘

EN is set from the first command on; the vehicle must answer within `limit_ticks` (20 looks of 20 ms in the source).
A lost engagement is never taken back by itself: that needs a new request. The steps are a kernel, `look`, so that a
compiled batch takes the same ones; `Handshake` is what a node holds.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from tunefree_hil.base.kernel import kernel

ANSWER_LIMIT_TICKS = 40  # 20 x 20 ms
CLEAR_EVERY_TICKS = 5  # 20 Hz
WHY_TICKS = 6  # a channel that is not enabled any more: the report that says why may come this much later


class Stage(Enum):
    """Where the take-over stands, in the order of the kernel's codes."""

    ENABLING = "waiting for the vehicle to report every channel enabled"
    CLEARING = "an override is latched: sending clear frames"
    ENGAGED = "engaged"
    NOT_ENABLED = "the vehicle did not report every channel enabled within 0.4 s"
    OVERRIDE = "the driver took over"
    FAULT = "a by-wire channel reports a fault"
    DROPPED = "a by-wire channel left the enabled state by itself"


STAGES = tuple(Stage)
ENABLING, CLEARING, ENGAGED, NOT_ENABLED, OVERRIDE, FAULT, DROPPED = range(len(STAGES))  # from NOT_ENABLED on: ended
ENDED = STAGES[NOT_ENABLED:]


class VehicleState(NamedTuple):
    """What the state bits of the reports say, all channels together. `known`: every enabled bit has been heard."""

    known: bool = False
    enabled: bool = False
    override: bool = False
    fault: bool = False


class Progress(NamedTuple):
    """State of `look`: code of the stage, the tick since which it waits, whether clear frames are due now."""

    stage: int = ENABLING
    since: int = 0
    clear_now: bool = False


@kernel
def watch(state: VehicleState, since: int, tick: int) -> Progress:
    """The stage after an engaged tick; since: the last one at which every channel was enabled."""
    if state.fault:
        return Progress(FAULT, since, False)
    if state.override:
        return Progress(OVERRIDE, since, False)
    if state.enabled:
        return Progress(ENGAGED, tick, False)
    return Progress(DROPPED if tick - since >= WHY_TICKS else ENGAGED, since, False)


@kernel
def look(progress: Progress, tick: int, state: VehicleState, limit_ticks: int) -> Progress:
    """Advance by one tick. An ended stage stays."""
    stage, since = progress.stage, progress.since
    if stage >= NOT_ENABLED:
        return Progress(stage, since, False)
    if stage == ENGAGED:
        return watch(state, since, tick)
    if state.fault:
        return Progress(FAULT, since, False)
    if state.override:
        if stage != CLEARING:
            since = tick
        waited = tick - since
        if waited >= limit_ticks:
            return Progress(NOT_ENABLED, since, False)
        return Progress(CLEARING, since, int(waited) % int(CLEAR_EVERY_TICKS) == 0)  # not 0: a constant
    if stage == CLEARING:
        since = tick
    if state.known and state.enabled:
        return Progress(ENGAGED, tick, False)
    return Progress(NOT_ENABLED if tick - since >= limit_ticks else ENABLING, since, False)


class Handshake:
    """One engagement. `look(tick, state)` once a tick gives the stage; `enable`, `clear_now` say what to send."""

    def __init__(self, limit_ticks: int = ANSWER_LIMIT_TICKS) -> None:
        self.limit_ticks = limit_ticks
        self._progress = Progress()

    @property
    def stage(self) -> Stage:
        """Where the take-over stands."""
        return STAGES[self._progress.stage]

    @property
    def clear_now(self) -> bool:
        """Whether clear frames are to be sent at this tick."""
        return self._progress.clear_now

    @property
    def enable(self) -> bool:
        """Whether commands go out with their enable bit set."""
        return self._progress.stage in (ENABLING, ENGAGED)

    def look(self, tick: int, state: VehicleState) -> Stage:
        """Advance by one tick. An ended stage stays."""
        self._progress = look(self._progress, tick, state, self.limit_ticks)
        return self.stage
