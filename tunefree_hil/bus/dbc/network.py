"""Reads the DBC of a vehicle folder: messages, and the bits of a signal."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.dbc.message_map import SignalMap
from tunefree_hil.bus.python_can import absent

with absent("asammdf"):  # cantools imports python-can
    import cantools
    from cantools.database.utils import start_bit

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

    from tunefree_hil.config.schema import VehicleSpec


def read_network(spec: VehicleSpec) -> dict[str, Message]:
    """Every message of the folder's DBC files, by name. Raises InputError with file and, where there is one, line."""
    messages: dict[str, Message] = {}
    for name in spec.dbc:
        path = Path(spec.folder) / name
        for message in _read(path).messages:
            if message.name in messages:
                raise InputError(
                    f"message {message.name} is defined twice", code="dbc", file=str(path), hint="rename or remove one"
                )
            messages[message.name] = message
    return messages


def _read(path: Path) -> Database:
    if not path.is_file():
        raise InputError("there is no such file", code="no_file", file=str(path), hint="see `dbc` in vehicle.toml")
    try:
        # strict=False: check_vehicle reports overlapping signals with all other problems
        return cast("Database", cantools.database.load_file(path, strict=False, database_format="dbc"))
    except (cantools.database.errors.UnsupportedDatabaseFormatError, UnicodeDecodeError) as error:
        raise InputError(
            f"this is no DBC: {error}", code="dbc", file=str(path), hint="correct the line it names"
        ) from error


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint: the name that was probably meant, or all known ones."""
    known = sorted(known)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean {close[0]}?" if close else f"there are {', '.join(known) or 'none'}"


def signal_map(signal: Signal, length: int) -> SignalMap:
    """Place and scaling of a signal's bits in a message of `length` bytes."""
    big = signal.byte_order == "big_endian"
    end = start_bit(signal) + signal.length
    low, high = raw_range(signal)
    return SignalMap(
        name=signal.name,
        shift=8 * length - end if big else signal.start,
        bits=signal.length,
        big_endian=big,
        signed=signal.is_signed,
        is_float=signal.conversion.is_float,
        factor=signal.scale,
        offset=signal.offset,
        raw_low=low,
        raw_high=high,
        end_bit=end,
    )


def bit_range(signal: Signal) -> tuple[int, int]:
    """The range of raw values of the bits."""
    if signal.is_signed:
        return -(1 << (signal.length - 1)), (1 << (signal.length - 1)) - 1
    return 0, (1 << signal.length) - 1


def raw_range(signal: Signal) -> tuple[int, int]:
    """The raw values that encode may send: the declared range where it is one that the bits can reach.

    Ranges such as [0|65535] on a signed 16-bit signal are common mistakes; then the bits decide.
    """
    low, high = bit_range(signal)
    declared = declared_raw(signal)
    if declared is None or not _is_believable(declared, low, high):
        return low, high
    return max(low, math.ceil(declared[0] - 1e-6)), min(high, math.floor(declared[1] + 1e-6))


def declared_raw(signal: Signal) -> tuple[float, float] | None:
    """The declared range in raw steps, or None where none is declared."""
    low, high = signal.minimum, signal.maximum
    if low is None or high is None or low >= high or signal.scale == 0:
        return None
    raws = [(float(end) - signal.offset) / signal.scale for end in (low, high)]
    return min(raws), max(raws)


def _is_believable(declared: tuple[float, float], low: int, high: int) -> bool:
    return declared[0] >= low - 1 and declared[1] <= high + 1


def overlaps(message: Message) -> list[tuple[str, str]]:
    """Pairs of signals that share bits (of a message that is not multiplexed)."""
    owner: dict[int, str] = {}
    pairs: list[tuple[str, str]] = []
    for signal in message.signals:
        for bit in bits_of(signal):
            holder = owner.setdefault(bit, signal.name)
            if holder != signal.name and (holder, signal.name) not in pairs:
                pairs.append((holder, signal.name))
    return pairs


def bits_of(signal: Signal) -> Sequence[int]:
    """The payload bits of a signal; bit 8 * i + j is bit j (0 the lowest) of byte i."""
    if signal.byte_order == "little_endian":
        return range(signal.start, signal.start + signal.length)
    first = start_bit(signal)
    return [8 * (place // 8) + 7 - place % 8 for place in range(first, first + signal.length)]
