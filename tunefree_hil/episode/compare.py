"""Compares two logs of the same drive: the first tick, id and signal that differ (`replay --verify`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.episode.frame_hash import PlacedFrame, place_frames


class Divergence(NamedTuple):
    """The first difference. signal: its name, 'frame' (one log lacks it), 'flags' or 'data' (no signal differs).

    first, second: the values of the two logs in the unit of the DBC (raw where the signal has a role), or text.
    """

    tick: int
    phase: int
    can_id: int
    message: str
    signal: str
    first: float | str
    second: float | str

    def sentence(self) -> str:
        """The difference as text."""
        place = f"tick {self.tick}, {self.message} (0x{self.can_id & 0x1FFFFFFF:X}), {self.signal}"
        return f"{place}: {self.first} in the first log, {self.second} in the second"


def compare_logs(first: Path, second: Path, codec: Codec, dt_s: float) -> Divergence | None:
    """None when both logs hold the same vehicle frames at the same ticks (then their frame hashes are equal too)."""
    commands = {message.key for message in codec.commands}
    placed = [place_frames(read_candump(path), dt_s, commands, codec.by_id.keys())[0] for path in (first, second)]
    return first_divergence(placed[0], placed[1], codec)


def first_divergence(a: Sequence[PlacedFrame], b: Sequence[PlacedFrame], codec: Codec) -> Divergence | None:
    """The first difference of two drives, frames in the order of the hash."""
    for first, second in zip(a, b, strict=False):
        if _place(first) != _place(second):
            early, words = (
                (first, ("sent", "missing")) if _place(first) < _place(second) else (second, ("missing", "sent"))
            )
            return _divergence(early, codec, "frame", *words)
        if first.frame.data != second.frame.data:
            return _divergence(first, codec, *_differing(first, second, codec))
        if first.frame.flags != second.frame.flags:
            return _divergence(first, codec, "flags", first.frame.flags, second.frame.flags)
    if len(a) > len(b):
        return _divergence(a[len(b)], codec, "frame", "sent", "missing")
    if len(b) > len(a):
        return _divergence(b[len(a)], codec, "frame", "missing", "sent")
    return None


def _place(item: PlacedFrame) -> tuple[int, ...]:
    """Where a frame stands in an episode: tick, phase, id."""
    return item.k, item.phase, item.can_id


class SignalDifference(NamedTuple):
    """The first signal that differs between two frames; 'data' with both as hexadecimal text where none does."""

    signal: str
    first: float | str
    second: float | str


def _differing(first: PlacedFrame, second: PlacedFrame, codec: Codec) -> SignalDifference:
    values, other_values = _decoded(first, codec), _decoded(second, codec)
    for name, value in values.items():
        against = other_values.get(name)
        if against is not None and value != against and (value == value or against == against):  # NaN equals NaN
            return SignalDifference(name, value, against)
    return SignalDifference("data", first.frame.data.hex().upper(), second.frame.data.hex().upper())


def _decoded(item: PlacedFrame, codec: Codec) -> Mapping[str, float]:
    message = codec.by_id[item.can_id]
    return codec.decode(message, item.frame.data) if message.fits(item.frame.data) else {}


def _divergence(item: PlacedFrame, codec: Codec, signal: str, first: float | str, second: float | str) -> Divergence:
    return Divergence(item.k, item.phase, item.can_id, codec.by_id[item.can_id].name, signal, first, second)
