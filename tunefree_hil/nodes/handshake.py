"""Taking over a by-wire vehicle: the controller's side of enable, clear and override (docs/reference/by_wire.md).

    WAIT ── nothing latched ──> ENABLING ── every channel is enabled ──> ENGAGED ── override, fault, dropped ──> LOST
      └── override latched ──> CLEARING ──┘

EN is set from the first command on; the vehicle must answer within ANSWER_LIMIT_S (20 checks of 20 ms in the source).
A lost engagement is never resumed without a new request. The steps are a kernel, `advance`, so that
a compiled batch takes the same ones; a node uses `Handshake`.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from tunefree_hil.base.kernel import kernel

ANSWER_LIMIT_S = 0.4  # 20 x 20 ms
CLEAR_EVERY_S = 0.05  # 20 Hz
WHY_S = 0.06  # a channel that is not enabled any more: the report with the reason may come this much later


class Stage(Enum):
    """Where the take-over stands, in the order of the kernel's codes."""

    ENABLING = "waiting for the vehicle to report every channel enabled"
    CLEARING = "an override is latched: sending clear frames"
    ENGAGED = "engaged"
    NOT_ENABLED = f"the vehicle did not report every channel enabled within {ANSWER_LIMIT_S:g} s"
    OVERRIDE = "the driver took over"
    FAULT = "a by-wire channel reports a fault"
    DROPPED = "a by-wire channel left the enabled state by itself"


STAGES = tuple(Stage)
ENABLING, CLEARING, ENGAGED, NOT_ENABLED, OVERRIDE, FAULT, DROPPED = range(len(STAGES))  # from NOT_ENABLED on: ended
ENDED = STAGES[NOT_ENABLED:]


class VehicleState(NamedTuple):
    """State bits of the reports, all channels together. `known`: every enabled bit has been received."""

    known: bool = False
    enabled: bool = False
    override: bool = False
    fault: bool = False


class Progress(NamedTuple):
    """State of `advance`: code of the stage, the tick since which it waits, whether clear frames are due now."""

    stage: int = ENABLING
    since: int = 0
    clear_now: bool = False


class Limits(NamedTuple):
    """The same times in ticks of a vehicle, each at least 1."""

    answer_ticks: int
    clear_ticks: int
    why_ticks: int


def limits_of(tick_s: float) -> Limits:
    """Limits in ticks of this length."""
    return Limits(*(max(1, round(time_s / tick_s)) for time_s in (ANSWER_LIMIT_S, CLEAR_EVERY_S, WHY_S)))


@kernel
def watch(state: VehicleState, since: int, tick: int, why_ticks: int) -> Progress:
    """The stage after an engaged tick; since: the last one at which every channel was enabled."""
    if state.fault:
        return Progress(FAULT, since, False)
    if state.override:
        return Progress(OVERRIDE, since, False)
    if state.enabled:
        return Progress(ENGAGED, tick, False)
    return Progress(DROPPED if tick - since >= why_ticks else ENGAGED, since, False)


@kernel
def advance(progress: Progress, tick: int, state: VehicleState, limits: Limits) -> Progress:
    """Advance by one tick. An ended stage stays."""
    stage, since = progress.stage, progress.since
    if stage >= NOT_ENABLED:
        return Progress(stage, since, False)
    if stage == ENGAGED:
        return watch(state, since, tick, limits.why_ticks)
    if state.fault:
        return Progress(FAULT, since, False)
    if state.override:
        if stage != CLEARING:
            since = tick
        waited = tick - since
        if waited >= limits.answer_ticks:
            return Progress(NOT_ENABLED, since, False)
        return Progress(CLEARING, since, int(waited) % int(limits.clear_ticks) == 0)  # not 0: limits_of
    if stage == CLEARING:
        since = tick
    if state.known and state.enabled:
        return Progress(ENGAGED, tick, False)
    return Progress(NOT_ENABLED if tick - since >= limits.answer_ticks else ENABLING, since, False)


class Handshake:
    """One engagement. `advance(tick, state)` once a tick gives the stage; `enable`, `clear_now`: frames to send."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
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

    def advance(self, tick: int, state: VehicleState) -> Stage:
        """Advance by one tick. An ended stage stays."""
        self._progress = advance(self._progress, tick, state, self.limits)
        return self.stage
