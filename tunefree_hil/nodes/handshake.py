"""Taking over a by-wire vehicle: the controller's side of enable, clear and override (apollo_facts 7.3).

    WAIT ── nothing latched ──> ENABLING ── every channel says enabled ──> ENGAGED ── override, fault, dropped ──> LOST
      └── override latched ──> CLEARING ──┘

EN is set from the first command on; the vehicle must answer within `limit_ticks` (20 looks of 20 ms in the source).
A lost engagement is never taken back by itself: that needs a new request.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

ANSWER_LIMIT_TICKS = 40  # 20 x 20 ms
CLEAR_EVERY_TICKS = 5  # 20 Hz


class Stage(Enum):
    """Where the take-over stands."""

    ENABLING = "waiting for the vehicle to report every channel enabled"
    CLEARING = "an override is latched: sending clear frames"
    ENGAGED = "engaged"
    NOT_ENABLED = "the vehicle did not report every channel enabled within 0.4 s"
    OVERRIDE = "the driver took over"
    FAULT = "a by-wire channel reports a fault"
    DROPPED = "a by-wire channel left the enabled state by itself"


ENDED = (Stage.NOT_ENABLED, Stage.OVERRIDE, Stage.FAULT, Stage.DROPPED)


class VehicleState(NamedTuple):
    """What the state bits of the reports say, all channels together. `known`: every enabled bit has been heard."""

    known: bool = False
    enabled: bool = False
    override: bool = False
    fault: bool = False


class Handshake:
    """One engagement. `look(tick, state)` once a tick gives the stage; `enable`, `clear_now` say what to send."""

    def __init__(self, limit_ticks: int = ANSWER_LIMIT_TICKS) -> None:
        self.limit_ticks = limit_ticks
        self.stage = Stage.ENABLING
        self.clear_now = False
        self._since = 0

    @property
    def enable(self) -> bool:
        """Whether commands go out with their enable bit set."""
        return self.stage in (Stage.ENABLING, Stage.ENGAGED)

    def look(self, tick: int, state: VehicleState) -> Stage:
        """Advance by one tick. An ended stage stays."""
        self.clear_now = False
        if self.stage in ENDED:
            return self.stage
        if self.stage is Stage.ENGAGED:
            self.stage = self._watch(state)
        elif state.fault:
            self.stage = Stage.FAULT
        elif state.override:
            self._clear(tick)
        else:
            self._enable(tick, state)
        return self.stage

    @staticmethod
    def _watch(state: VehicleState) -> Stage:
        if state.fault:
            return Stage.FAULT
        if state.override:
            return Stage.OVERRIDE
        return Stage.ENGAGED if state.enabled else Stage.DROPPED

    def _clear(self, tick: int) -> None:
        if self.stage is not Stage.CLEARING:
            self.stage, self._since = Stage.CLEARING, tick
        self.clear_now = (tick - self._since) % CLEAR_EVERY_TICKS == 0
        if tick - self._since >= self.limit_ticks:
            self.stage, self.clear_now = Stage.NOT_ENABLED, False

    def _enable(self, tick: int, state: VehicleState) -> None:
        if self.stage is Stage.CLEARING:
            self.stage, self._since = Stage.ENABLING, tick
        if state.known and state.enabled:
            self.stage = Stage.ENGAGED
        elif tick - self._since >= self.limit_ticks:
            self.stage = Stage.NOT_ENABLED
