"""Choice of the next missing cell: the one that is reached fastest, by speed, steering and free distance."""

from __future__ import annotations

from tunefree_hil.collect.cells import FIRST_THROTTLE, NO_CELL, SPEED_BAND_COUNT, STRAIGHT, TargetCell
from tunefree_hil.collect.envelope import Envelope, run_up_m, turn_back_room_m
from tunefree_hil.collect.features import PlannerParams, PlannerState, PlannerTick
from tunefree_hil.collect.steering import steer_band

# Entry speeds as shares of a cell's speed window, by pedal band: high before braking, low before accelerating.
ENTRIES = ((0.45, 1.0), (0.30, 1.0), (0.15, 1.0), (0.15, 1.0), (0.0, 0.8), (0.0, 0.6))
FAST_ENTRY = 0.3  # in the open speed band, where higher speeds need a long distance
ACCEL_MPS2, DECEL_MPS2 = 1.5, 2.5  # assumed acceleration to the entry speed
SWITCH_S = 0.4  # cost of a step of steering bands
TURN_BACK_S = 6.0  # cost of turning back for more room
FAST_BONUS_S = 5.0  # bonus for each speed band for which there is room now
SKIPPED_S = 40.0  # cost of a cell that could not be reached the last time
DWELL_S = 1.0


def entry_speeds_mps(target: TargetCell) -> tuple[float, float]:
    """Lowest and highest speed at which a cell is entered."""
    low, high = ENTRIES[target.index.pedal]
    if target.index.speed == SPEED_BAND_COUNT - 1:
        low = min(low, FAST_ENTRY)
    width = target.high_mps - target.low_mps
    return target.low_mps + low * width, target.low_mps + high * width


def choose_cell(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> int:
    """Number of the next cell, NO_CELL where all are full."""
    best, least, steer = NO_CELL, 0.0, steer_band(p.bands, tick.signals)
    for number, target in enumerate(p.targets):
        if not s.counter.lacks(number):
            continue
        cost = _cost(target, p.envelope, steer, tick) + (SKIPPED_S if number == s.skipped_cell else 0.0)
        if best == NO_CELL or cost < least:
            best, least = number, cost
    return best


def _cost(target: TargetCell, envelope: Envelope, steer: int, tick: PlannerTick) -> float:
    """Time until a cell is entered, s; steer: index of the current steering band."""
    (low, high), speed_mps = entry_speeds_mps(target), tick.signals.speed_mps
    if speed_mps < low:
        entered, cost = low, (low - speed_mps) / ACCEL_MPS2
    elif speed_mps > high:
        entered, cost = high, (speed_mps - high) / DECEL_MPS2
    else:
        entered, cost = speed_mps, 0.0
    cost += SWITCH_S * abs(target.index.steer - steer)
    needed = run_up_m(envelope, min(speed_mps, entered), entered) + DWELL_S * entered
    if abs(target.index.steer - STRAIGHT) < 2:  # the tighter ones are driven in circles
        needed += turn_back_room_m(envelope, entered)
    if target.index.pedal >= FIRST_THROTTLE:
        needed += entered
    if needed > tick.room_m:
        return cost + TURN_BACK_S
    return cost - FAST_BONUS_S * target.index.speed
