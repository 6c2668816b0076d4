"""The largest swing that a signal sustains over several half cycles: turning points, and a search of the threshold.

A turning point counts at a threshold where the signal comes back from it by at least that much, so noise on top of a
swing does not split it. The signal before its high-pass has to turn there, too: a high-pass makes six half cycles of a
single pulse. At a higher threshold some points count no more and none is added, so the search finds the largest.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.kernel import compiled, kernel

BISECTIONS = 18  # the sustained range is number to 4e-6 of the largest one


class SwingRules(NamedTuple):
    """What sustains. half_cycles: needed one after the other, none longer than max_half_cycle_s.

    begin_s: half cycles that begin earlier do not count.
    motion_share: least height of a turn of the signal itself / the range, so that what a high-pass makes of a step or a
    pulse does not count.
    run_share: of the sustained range; half cycles of that size before and after belong to the same oscillation.
    """

    half_cycles: int
    max_half_cycle_s: float
    begin_s: float
    run_share: float
    motion_share: float


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
    """Rows of floats that the search fills, each as long as the signal. motions: of the signal before its high-pass."""

    times_s: Any
    values: Any
    motions: Any
    turns: Any


class SwingSamples(NamedTuple):
    """A signal in its band, and before the high-pass, at the same `count` times every dt_s."""

    values: Any
    motions: Any
    count: int
    dt_s: float


@kernel
def find_turning_points(samples: SwingSamples, buffers: SwingBuffers) -> int:
    """Fill times_s and values with the local extremes, each the vertex of the parabola through three samples.

    Returns:
        Their number.
    """
    values, motions = samples.values, samples.motions
    number = 0
    for i in range(1, samples.count - 1):
        before = values[i] - values[i - 1]
        after = values[i + 1] - values[i]
        bend = after - before
        if bend == 0.0 or before * after > 0.0 or before == 0.0:
            continue
        offset = -0.5 * (before + after) / bend
        buffers.times_s[number] = (i + offset) * samples.dt_s
        buffers.values[number] = values[i] + 0.25 * (before + after) * offset
        buffers.motions[number] = motions[i]
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
def is_turn_of_motion(buffers: SwingBuffers, i: int, least: float) -> bool:
    """Whether the signal itself turns at the turn i: it stands out of the line between the turns beside it."""
    before, here, after = int(buffers.turns[i - 1]), int(buffers.turns[i]), int(buffers.turns[i + 1])
    span_s = buffers.times_s[after] - buffers.times_s[before]
    share = (buffers.times_s[here] - buffers.times_s[before]) / span_s  # not 0: two extremes lie at least a step apart
    line = buffers.motions[before] + share * (buffers.motions[after] - buffers.motions[before])
    return abs(buffers.motions[here] - line) >= least  # to either side: a large slow swing may bend it the other way


@kernel
def find_run(buffers: SwingBuffers, count: int, threshold: float, rules: SwingRules, after_s: float) -> SwingRun:
    """The first run at a threshold that ends at `after_s` or later; its range is 0 where there is none."""
    turns = select_turns(buffers.values, count, threshold, buffers.turns)
    start_s, last_s, halves = 0.0, 0.0, 0
    for i in range(turns):
        time_s = buffers.times_s[int(buffers.turns[i])]
        is_joined = i > 0 and last_s >= rules.begin_s and time_s - last_s <= rules.max_half_cycle_s
        goes_on = is_joined
        if goes_on and halves > 0:
            goes_on = is_turn_of_motion(buffers, i - 1, rules.motion_share * threshold)
        if goes_on:
            halves += 1
        else:
            if halves >= rules.half_cycles and last_s >= after_s:
                break
            if is_joined:
                start_s, halves = last_s, 1
            else:
                start_s, halves = time_s, 0
        last_s = time_s
    if halves >= rules.half_cycles and last_s >= after_s:
        return SwingRun(threshold, start_s, last_s, halves)
    return SwingRun(0.0, 0.0, 0.0, 0)


@kernel
def find_sustained_swing(samples: SwingSamples, rules: SwingRules, buffers: SwingBuffers) -> SustainedSwing:
    """The run with the largest range that enough half cycles in a row all reach, and how long it goes on."""
    points = find_turning_points(samples, buffers)
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
    around = find_run(buffers, points, rules.run_share * best.range, rules, best.end_s)
    return SustainedSwing(best, around if around.range > 0.0 else best)


find_sustained_swing_fast = compiled(find_sustained_swing)
