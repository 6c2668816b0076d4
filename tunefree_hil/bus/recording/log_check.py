"""Judges recorded frames by a vehicle's folder: rates, gaps, counters, CRCs, lengths, values, foreign ids."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.e2e import is_intact
from tunefree_hil.bus.dbc.integrity import Order, check_counter
from tunefree_hil.bus.dbc.message_map import COMMAND, MessageMap
from tunefree_hil.bus.formats.rows import ERROR, RTR

Frame = tuple[float, str, int, bytes, int]  # time_s, channel, can_id with EFF bit, data, flags: candump.LogFrame
LATE = 1.5  # periods
LONG = 5.0  # periods; or the message's own time-out where that is longer


class MessageHealth(NamedTuple):
    """One message of the folder in a log.

    late: gaps above 1.5 periods. By its counter: lost, repeated, swapped (came after a later one). short: bytes lack.
    broken: CRC or data id do not fit; None where the folder has no profile to check them by. beyond: a value outside
    the range that the DBC declares.
    """

    name: str
    kind: str
    period_ms: float
    frames: int
    rate_hz: float
    longest_gap_s: float
    late: int
    lost: int
    repeated: int
    swapped: int
    short: int
    broken: int | None
    beyond: int


class _Counter:
    """Follows a message's counter, and distinguishes frames out of order from lost frames."""

    def __init__(self, modulus: int) -> None:
        self.modulus = modulus
        self.last: int | None = None
        self.lost = self.repeated = self.swapped = 0
        self._back = False  # the frame before went backwards too: then it is a new start, not a swap

    def receive(self, counter: int) -> None:
        """Take in the counter of the next frame."""
        counted = check_counter(self.last, counter, self.modulus)
        backwards = counted.lost + 1 > self.modulus // 2 and counted.order is not Order.FIRST
        if backwards and not self._back:
            self.swapped += 1
            self.lost = max(0, self.lost - 1)  # the frame counted as lost has arrived
            self._back = True
            return
        self.repeated += counted.order is Order.REPEATED
        self.lost += 0 if backwards else counted.lost
        self.last, self._back = counter, False


class LogHealth(NamedTuple):
    """All messages in the folder's order, foreign ids with their counts, and the problems as text."""

    messages: list[MessageHealth]
    foreign: dict[int, int]
    problems: list[str]
    frames: int  # all of them, error and remote frames too
    span_s: float  # from the earliest stamp to the latest


class _MessageCheck:
    """Counts of one message."""

    def __init__(self, message: MessageMap, tick_s: float) -> None:
        self.message = message
        self.period_s = message.period_ticks * tick_s
        self.limit_s = max(LONG * self.period_s, message.timeout_ticks * tick_s)
        self.counter = _Counter(message.counter_modulus or 1)
        self.frames = self.late = self.short = self.broken = self.never = 0
        self.beyond: dict[str, int] = {}
        self.ranges = declared_ranges(message)
        self.first_s = self.last_s = self.longest_gap_s = 0.0
        self.longest_at_s = 0.0

    def receive(self, codec: Codec, time_s: float, data: bytes) -> None:
        """Take in one frame."""
        if self.frames:
            gap_s = time_s - self.last_s
            self.late += gap_s > LATE * self.period_s
            if gap_s > self.longest_gap_s:
                self.longest_gap_s, self.longest_at_s = gap_s, self.last_s
        else:
            self.first_s = time_s
        self.frames += 1
        self.last_s = time_s
        if not self.message.fits(data):
            self.short += 1
        elif self.message.e2e is not None and not is_intact(self.message.e2e, data[: self.message.length]):
            self.broken += 1  # neither its values nor its counter are usable
        else:
            self._look_into(codec.decode(self.message, data))

    def _look_into(self, decoded: Mapping[str, float]) -> None:
        """Count on, and note values outside the range of the DBC."""
        if self.message.counter in decoded:  # a truncated frame may end before it
            counted = int(decoded[self.message.counter])
            self.never += self.message.e2e is not None and counted >= self.message.counter_modulus
            self.counter.receive(counted)
        for name, (low, high) in self.ranges.items():
            if name in decoded and not low <= decoded[name] <= high:
                self.beyond[name] = self.beyond.get(name, 0) + 1

    def end(self, earliest_s: float, latest_s: float) -> None:
        """End of the log: a report that stopped, or came late, has a gap up to the log's end. Commands may begin
        and end at any time.
        """
        if not self.frames or self.message.kind == COMMAND:
            return
        for gap_s, at_s in ((self.first_s - earliest_s, earliest_s), (latest_s - self.last_s, self.last_s)):
            if gap_s > self.longest_gap_s:
                self.longest_gap_s, self.longest_at_s = gap_s, at_s

    def health(self) -> MessageHealth:
        """The counts."""
        span_s = self.last_s - self.first_s
        rate_hz = (self.frames - 1) / span_s if self.frames > 1 and span_s > 0.0 else 0.0
        message, counter = self.message, self.counter
        head = (message.name, message.kind, 1000.0 * self.period_s, self.frames, rate_hz, self.longest_gap_s, self.late)
        broken = None if message.e2e is None else self.broken
        beyond = sum(self.beyond.values())
        return MessageHealth(*head, counter.lost, counter.repeated, counter.swapped, self.short, broken, beyond)

    def problems(self) -> list[str]:
        """Problems of this message. Commands may be missing: a log can begin before the first command."""
        name, problems = self.message.name, []
        if not self.frames:
            return [] if self.message.kind == COMMAND else [f"{name} was never received"]
        if self.longest_gap_s > self.limit_s:
            problems.append(f"{name} is silent for {self.longest_gap_s:.2f} s from {self.longest_at_s:.2f} s on")
        if self.short:
            problems.append(f"{name}: {self.short} frames are shorter than the DBC says")
        if self.broken:
            problems.append(f"{name}: the CRC or data id of {self.broken} frames does not fit")
        if self.never:
            most = self.message.counter_modulus - 1
            problems.append(f"{name}: {self.never} frames are counted beyond {most}, which its E2E profile never does")
        for signal, count in self.beyond.items():
            low, high = self.ranges[signal]
            problems.append(f"{name}: {signal} is outside its [{low:g}, {high:g}] in {count} frames")
        if self.counter.lost:
            problems.append(f"{name}: {self.counter.lost} frames are missing by its counter")
        if self.counter.repeated:
            problems.append(f"{name}: {self.counter.repeated} times the counter stood still")
        if self.counter.swapped:
            problems.append(f"{name}: {self.counter.swapped} frames came out of order")
        return problems


def declared_ranges(message: MessageMap) -> dict[str, tuple[float, float]]:
    """Physical (low, high) of the signals whose DBC declares less than their bits allow; half a step of slack."""
    ranges = {}
    codes = {message.enable, message.clear, message.ignore, message.counter, message.checksum}
    codes |= {state.signal for state in message.states}
    for name, signal in message.signals.items():
        low, high = (-(signal.mask + 1) // 2, signal.mask // 2) if signal.signed else (0, signal.mask)
        if name not in codes and not signal.is_float and (signal.raw_low, signal.raw_high) != (low, high):
            ends = [raw * signal.factor + signal.offset for raw in (signal.raw_low - 0.5, signal.raw_high + 0.5)]
            ranges[name] = (min(ends), max(ends))
    return ranges


def check_frames(frames: Iterable[Frame], codec: Codec, by_channel: bool = False) -> LogHealth:
    """Judge frames in the order in which they were recorded. `by_channel`: the log's channels are the folder's."""
    tick_s = codec.tick_ms / 1000.0
    messages = (*codec.telemetry, *codec.commands)
    checks = {(one.key, one.channel if by_channel else ""): _MessageCheck(one, tick_s) for one in messages}
    foreign: dict[int, int] = {}
    errors = remote = backwards = count = 0
    last_s, earliest_s, latest_s = float("-inf"), float("inf"), float("-inf")
    for time_s, channel, can_id, data, flags in frames:
        count += 1
        backwards += time_s < last_s
        last_s, earliest_s, latest_s = time_s, min(earliest_s, time_s), max(latest_s, time_s)
        if flags & (ERROR | RTR):
            errors += bool(flags & ERROR)
            remote += not flags & ERROR
            continue
        check = checks.get((can_id, channel)) or checks.get((can_id, ""))
        if check is not None:
            check.receive(codec, time_s, data)
        else:
            foreign[can_id] = foreign.get(can_id, 0) + 1
    for check in checks.values():
        check.end(earliest_s, latest_s)
    problems = [problem for check in checks.values() for problem in check.problems()]
    problems += [f"{errors} error frames: the wiring or the bit rate"] if errors else []
    problems += [f"{remote} remote frames, which no vehicle here asks for"] if remote else []
    problems += [f"time runs backwards {backwards} times"] if backwards else []
    span_s = max(0.0, latest_s - earliest_s)
    return LogHealth(
        [check.health() for check in checks.values()], dict(sorted(foreign.items())), problems, count, span_s
    )
