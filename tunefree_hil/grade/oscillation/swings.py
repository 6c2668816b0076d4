"""The largest swing that a signal sustains over several half cycles: turning points, and a search of the threshold.

A turning point counts at a threshold where the signal comes back from it by at least that much, so noise on top of a
swing does not split it. At a higher threshold some of them count no more and none is added, so the search is exact.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.kernel import compiled, kernel

BISECTIONS = 18  # the sustained range is number to 4e-6 of the largest one


class SwingRules(NamedTuple):
    """What sustains. half_cycles: needed one after the other, none longer than max_half_cycle_s.

    run_share: of the sustained range; half cycles of that size before and after belong to the same oscillation.
    """

    half_cycles: int
    max_half_cycle_s: float
    run_share: float


class SwingRun(NamedTuple):
    """Half cycles in a row that all reach a range (0: there is no run): its first and last turn, and their number."""

    range: float
    start_s: float
    end_s: float
    half_cycles: int


class SustainedSwing(NamedTuple):
    """The run of the largest range, and the longer one around it that reaches `run_share` of that range."""

    largest: SwingRun
    around: SwingRun


class SwingBuffers(NamedTuple):
    """Rows of floats that the search fills, each as long as the signal."""

    times_s: Any
    values: Any
    turns: Any


@kernel
def find_turning_points(samples: Any, count: int, dt_s: float, buffers: SwingBuffers) -> int:
    """Fill times_s and values with the local extremes, each the vertex of the parabola through three samples.

    Returns:
        Their number.
    """
    number = 0
    for i in range(1, count - 1):
        before = samples[i] - samples[i - 1]
        after = samples[i + 1] - samples[i]
        bend = after - before
        if bend == 0.0 or before * after > 0.0 or before == 0.0:
            continue
        offset = -0.5 * (before + after) / bend
        buffers.times_s[number] = (i + offset) * dt_s
        buffers.values[number] = samples[i] + 0.25 * (before + after) * offset
        number += 1
    return number


@kernel
def select_turns(values: Any, count: int, threshold: float, turns: Any) -> int:
    """Fill `turns` with the indices of the extremes that count at a threshold, in turn a low and a high one.

    Returns:
        Their number.
    """
    number = 0
    low, high = 0, 0
    direction = 0.0  # 1.0: the last turn was a low one
    for i in range(1, count):
        value = values[i]
        if value > values[high]:
            high = i
        if value < values[low]:
            low = i
        if direction <= 0.0 and value - values[low] >= threshold:
            turns[number] = float(low)
            number += 1
            direction, high = 1.0, i
        elif direction >= 0.0 and values[high] - value >= threshold:
            turns[number] = float(high)
            number += 1
            direction, low = -1.0, i
    if number > 0:
        turns[number] = float(high) if direction > 0.0 else float(low)
        number += 1
    return number


@kernel
def find_run(buffers: SwingBuffers, count: int, threshold: float, rules: SwingRules, after_s: float) -> SwingRun:
    """The first run at a threshold that ends at `after_s` or later; its range is 0 where there is none."""
    turns = select_turns(buffers.values, count, threshold, buffers.turns)
    start_s, last_s, halves = 0.0, 0.0, 0
    for i in range(turns):
        time_s = buffers.times_s[int(buffers.turns[i])]
        if i > 0 and time_s - last_s <= rules.max_half_cycle_s:
            halves += 1
        else:
            if halves >= rules.half_cycles and last_s >= after_s:
                break
            start_s, halves = time_s, 0
        last_s = time_s
    if halves >= rules.half_cycles and last_s >= after_s:
        return SwingRun(threshold, start_s, last_s, halves)
    return SwingRun(0.0, 0.0, 0.0, 0)


@kernel
def find_sustained_swing(
    samples: Any, count: int, dt_s: float, rules: SwingRules, buffers: SwingBuffers
) -> SustainedSwing:
    """The run with the largest range that enough half cycles in a row all reach, and how long it goes on."""
    points = find_turning_points(samples, count, dt_s, buffers)
    best = SwingRun(0.0, 0.0, 0.0, 0)
    if points <= rules.half_cycles:
        return SustainedSwing(best, best)
    low, high = buffers.values[0], buffers.values[0]
    for i in range(points):
        low, high = min(low, buffers.values[i]), max(high, buffers.values[i])
    reached, missed = 0.0, high - low
    for _ in range(BISECTIONS):
        threshold = 0.5 * (reached + missed)
        run = find_run(buffers, points, threshold, rules, 0.0)
        if run.range > 0.0:
            reached, best = threshold, run
        else:
            missed = threshold
    return SustainedSwing(best, find_run(buffers, points, rules.run_share * best.range, rules, best.end_s))


find_sustained_swing_fast = compiled(find_sustained_swing)
