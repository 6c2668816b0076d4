"""Which missing cell comes next: the one that is nearest to reach, by speed first, then by steering and room."""

from __future__ import annotations

from collections.abc import Sequence

from tunefree_hil.collect.cells import FIRST_THROTTLE, NONE, SPEEDS, STRAIGHT, Counter, Target
from tunefree_hil.collect.envelope import Envelope, room_to_turn_m, run_up_m

# Where in a cell's window of speeds it is entered, as shares: whoever brakes enters fast, whoever accelerates slow.
ENTRIES = ((0.45, 1.0), (0.30, 1.0), (0.15, 1.0), (0.15, 1.0), (0.0, 0.8), (0.0, 0.6))
FAST_ENTRY = 0.3  # in the open band, where every m/s takes ground
GAIN_MPS2, LOSS_MPS2 = 1.5, 2.5  # how fast a gap of speed closes, reckoned
SWITCH_S = 0.4  # a step of steering bands
TURN_BACK_S = 6.0  # a turn for more room
FAST_BONUS_S = 5.0  # a band of speed for which there is room now: that room is rare
TIRED_S = 40.0  # a cell that could not be reached the last time
DWELL_S = 1.0


def entry_mps(target: Target) -> tuple[float, float]:
    """Speeds at which a cell is entered."""
    low, high = ENTRIES[target.place.pedal]
    if target.place.speed == SPEEDS - 1:
        low = min(low, FAST_ENTRY)
    width = target.high_mps - target.low_mps
    return target.low_mps + low * width, target.low_mps + high * width


def pick(
    targets: Sequence[Target],
    counter: Counter,
    envelope: Envelope,
    speed_mps: float,
    steer: int,
    room: float,
    tired: int,
) -> int:
    """The number of the next cell, NONE where all are full.

    steer: index of the steering band that is driven now. room: way ahead, m. tired: the cell that was given up last.
    """
    best, least = NONE, 0.0
    for number, target in enumerate(targets):
        if not counter.lacks(number):
            continue
        cost = _cost(target, envelope, speed_mps, steer, room) + (TIRED_S if number == tired else 0.0)
        if best == NONE or cost < least:
            best, least = number, cost
    return best


def _cost(target: Target, envelope: Envelope, speed_mps: float, steer: int, room: float) -> float:
    low, high = entry_mps(target)
    if speed_mps < low:
        entered, cost = low, (low - speed_mps) / GAIN_MPS2
    elif speed_mps > high:
        entered, cost = high, (speed_mps - high) / LOSS_MPS2
    else:
        entered, cost = speed_mps, 0.0
    cost += SWITCH_S * abs(target.place.steer - steer)
    needed = run_up_m(envelope, min(speed_mps, entered), entered) + DWELL_S * entered
    if abs(target.place.steer - STRAIGHT) < 2:  # the tighter ones are driven in circles
        needed += room_to_turn_m(envelope, entered)
    if target.place.pedal >= FIRST_THROTTLE:
        needed += entered
    if needed > room:
        return cost + TURN_BACK_S
    return cost - FAST_BONUS_S * target.place.speed
