"""Compiles a message's layout into the flat steps of encode and decode."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from tunefree_hil.bus.dbc.message_map import (
    TWO_PI,
    FieldMap,
    PlainStep,
    Plan,
    ReadStep,
    SignalMap,
    Term,
    Turn,
    WriteStep,
)


def make_plan(
    signals: Mapping[str, SignalMap], fields: Iterable[FieldMap], raw: set[str], constants: Mapping[str, float]
) -> Plan:
    """The plan of one message. `raw`: signals that decode leaves as their raw integer (roles and states)."""
    fields = tuple(fields)
    little, big = _constant_bits(signals, constants)
    reads = [_read_step(signal, signal.name in raw) for signal in signals.values() if not signal.is_float]
    reads.sort(key=lambda step: (step.factor, step.offset) != (1, 0))  # the order in which decode lists the signals
    return Plan(
        little=little,
        big=big,
        simple=tuple(
            _simple_steps(group, [_write_step(f) for f in fields if f.group == group and _is_simple(f)])
            for group in dict.fromkeys(field.group for field in fields)
        ),
        special=tuple(field for field in fields if not _is_simple(field)),
        raws={s.name: (s.mask, s.shift, ~(s.mask << s.shift), s.big_endian) for s in signals.values()},
        reads_little=tuple(step for step in reads if not signals[step.name].big_endian),
        reads_big=tuple(step for step in reads if signals[step.name].big_endian),
        floats=tuple(signal for signal in signals.values() if signal.is_float),
        values=tuple(
            (f.group, f.index, tuple((term.signal.name, term.scale) for term in f.terms), f.scale, f.offset)
            for f in fields
        ),
    )


def _read_step(signal: SignalMap, raw: bool) -> ReadStep:
    sign = 1 << (signal.bits - 1) if signal.signed else 0
    is_plain = raw or (signal.factor == 1 and signal.offset == 0)
    factor, offset = (1, 0) if is_plain else (signal.factor, signal.offset)  # 1, 0: a plain value stays an int
    return ReadStep(signal.name, signal.shift, signal.mask, sign, factor, offset)


def _write_step(field: FieldMap) -> WriteStep:
    signal, term_scale = field.terms[0]
    return WriteStep(
        index=field.index,
        offset=field.offset,
        scale=field.scale,
        term_scale=term_scale,
        signal_offset=float(signal.offset),
        factor=float(signal.factor),
        raw_low=float(signal.raw_low),
        raw_high=float(signal.raw_high),
        mask=signal.mask,
        shift=signal.shift,
        big=signal.big_endian,
    )


class GroupSteps(NamedTuple):
    """The steps of a group; plain are those whose scales and offsets change no bit of a value."""

    group: str
    plain: tuple[PlainStep, ...]
    scaled: tuple[WriteStep, ...]


def _simple_steps(group: str, steps: Iterable[WriteStep]) -> GroupSteps:
    plain, scaled = [], []
    for step in steps:
        is_plain = (step.offset, step.scale, step.term_scale, step.signal_offset, step.big) == (
            0.0,
            1.0,
            1.0,
            0.0,
            False,
        )
        if is_plain:
            plain.append(PlainStep(step.index, step.factor, step.raw_low, step.raw_high, step.mask, step.shift))
        else:
            scaled.append(step)
    return GroupSteps(group, tuple(plain), tuple(scaled))


def _is_simple(field: FieldMap) -> bool:
    return len(field.terms) == 1 and field.turn.raw_turn == 0.0


def _constant_bits(signals: Mapping[str, SignalMap], constants: Mapping[str, float]) -> tuple[int, int]:
    bits = [0, 0]
    for name, value in constants.items():
        signal = signals[name]
        raw = round((value - signal.offset) / signal.factor)
        raw = min(max(raw, signal.raw_low), signal.raw_high)
        bits[signal.big_endian] |= (raw & signal.mask) << signal.shift
    return bits[0], bits[1]


def sort_terms(terms: Iterable[Term]) -> tuple[Term, ...]:
    """Coarse terms first: encode gives each term the rest of those before it."""
    return tuple(sorted(terms, key=lambda term: -abs(term.signal.factor * term.scale)))


def heading_turn(terms: tuple[Term, ...], scale: float, offset: float) -> Turn:
    """The interval of one turn that a heading is wrapped into: [-pi, pi) or [0, 2 pi) where the signal reaches over it.

    Else the turn that begins at the signal's low end. check_vehicle refuses a signal that reaches less than a turn.
    """
    signal, term_scale = terms[0]
    step = signal.factor * term_scale * scale
    ends = [
        (raw * signal.factor + signal.offset) * term_scale * scale + offset for raw in (signal.raw_low, signal.raw_high)
    ]
    low, high, slack = min(ends), max(ends), abs(step) * 1.001
    steps = float(round(abs(TWO_PI / step)))
    for start in (-math.pi, 0.0):
        if low <= start + slack and start + TWO_PI <= high + slack:
            return Turn(start, steps)
    return Turn(low, steps)


def read_float(signal: SignalMap, little: int, big: int) -> float:
    """A floating-point signal of 16, 32 or 64 bits."""
    bits = ((big if signal.big_endian else little) >> signal.shift) & signal.mask
    form = {16: "<e", 32: "<f", 64: "<d"}[signal.bits]
    return struct.unpack(form, bits.to_bytes(signal.bits // 8, "little"))[0] * signal.factor + signal.offset
