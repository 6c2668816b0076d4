"""A log in columns, piece by piece: stamps, names and payloads as arrays, with never more than one piece in memory.

candump text is parsed a megabyte at a time. From the first unusual line on, the careful reader of episode/candump.py is
used, and for other formats their readers, so that errors have the same text.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.dbc.decode_columns import PAD, Payloads, payloads_of
from tunefree_hil.bus.formats.find import CANDUMP, format_of, load_format
from tunefree_hil.bus.formats.rows import LONGEST_LINE, Row
from tunefree_hil.episode.candump import BLOCK_BYTES, ERROR, EXTENDED_BIT, FD, RTR, read_rows

Array = np.ndarray
Name = tuple[str, int]  # channel, SocketCAN id with the EFF bit

ROWS_AT_ONCE = 20_000
_LABEL = re.compile(r" +(\S+) +([0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})")
_LONGEST_LABEL, _LONGEST_STAMP, _MOST_BYTES = 60, 24, 64
_ERROR_BIT, _ID_MASK = 0x20000000, 0x1FFFFFFF
_NIBBLES = np.full(256, PAD, dtype=np.uint8)  # of a hex digit; PAD for other characters
for _digit in b"0123456789abcdefABCDEF":
    _NIBBLES[_digit] = int(chr(_digit), 16)


class Piece(NamedTuple):
    """Frames in the file's order, as columns of n rows.

    name: which of `names` a frame has. flags: FD 1, RTR 8, ERROR 16 (episode/candump.py). done: share of the
    file read so far, 0 to 1; 0 where unknown.
    """

    time_s: Array
    name: Array
    names: tuple[Name, ...]
    payloads: Payloads
    flags: Array
    done: float = 0.0


def read_pieces(path: Path) -> Iterator[Piece]:
    """All frames of a log of any format; a last line that was cut off is left out (candump.cut_line reports it).

    Raises InputError with file and line, as the format's reader does, where the log is missing, empty or foreign.
    """
    kind = format_of(path)
    if kind != CANDUMP:
        yield from _pieces_of(_rows_of(path, kind))
        return
    frames = done = 0
    size = max(1, path.stat().st_size)
    for text in _texts(path):
        piece = parse_lines(text)
        if piece is None:
            break
        done, frames = done + len(text), frames + len(piece.time_s)
        yield piece._replace(done=done / size)
    else:
        if frames:
            return
    yield from _pieces_of(islice(read_rows(path, allow_cut=True), frames, None))


def _rows_of(path: Path, kind: str) -> Iterator[Row]:
    """The rows of a log that is no candump text; for one file of a ROS 2 bag, those of its folder."""
    inside = path.suffix in (".mcap", ".db3") and (path.parent / "metadata.yaml").is_file()
    received = False
    for row in load_format(kind).read(path.parent if inside else path):
        received = True
        yield row
    if not received:
        message, hint = "the log is empty: there is not one frame in it", "record it again, or export it anew"
        raise InputError(message, code="empty_log", file=str(path), hint=hint)


def _pieces_of(rows: Iterable[Row]) -> Iterator[Piece]:
    rows = iter(rows)
    while chunk := list(islice(rows, ROWS_AT_ONCE)):
        numbers: dict[Name, int] = {}
        name = np.array([numbers.setdefault((row.channel, row.can_id), len(numbers)) for row in chunk])
        time_s = np.array([row.time_s for row in chunk], dtype=np.float64)
        flags = np.array([row.flags & (FD | RTR | ERROR) for row in chunk], dtype=np.uint8)
        yield Piece(time_s, name, tuple(numbers), payloads_of([row.data for row in chunk]), flags)


def _texts(path: Path) -> Iterator[bytes]:
    """Whole lines, about BLOCK_BYTES at once. Other text is passed on, and the parser refuses it."""
    rest = b""
    with path.open("rb") as file:
        while piece := file.read(BLOCK_BYTES):
            whole, end, after = piece.rpartition(b"\n")
            if end:
                yield rest + whole + end
                rest = after
            else:
                rest += after
            if len(rest) > LONGEST_LINE:
                yield rest
                return


def parse_lines(text: bytes) -> Piece | None:
    """Whole lines of candump text; None where a line is not of the plain kind `(12.34) can0 123#0011`.

    Data or error frames, FD, remote, an ` R` or ` T` or a carriage return at the end are plain. The careful
    parser gives the same result for them.
    """
    codes = np.frombuffer(text, dtype=np.uint8)
    ends = np.flatnonzero(codes == ord("\n"))
    if not len(ends) or ends[-1] != len(codes) - 1 or (codes == 0).any():
        return None
    begins = np.concatenate([[0], ends[:-1] + 1])
    closes, hashes = _first(codes, ")", begins, ends), _first(codes, "#", begins, ends)
    if closes is None or hashes is None or (closes > hashes).any() or (codes[begins] != ord("(")).any():
        return None
    time_s = _stamps(codes, begins + 1, closes)
    labels = _labels(codes, closes + 1, hashes)
    data = _payloads(codes, hashes + 1, ends)
    if time_s is None or labels is None or data is None:
        return None
    name, names, errors = labels
    return Piece(time_s, name, names, data[0], data[1] | errors[name])


def _first(codes: Array, sign: str, begins: Array, ends: Array) -> Array | None:
    """Where `sign` stands first in each line; None where a line has none."""
    places = np.flatnonzero(codes == ord(sign))
    if not len(places):
        return None
    index = np.searchsorted(places, begins)
    nearest = places[np.minimum(index, len(places) - 1)]
    return nearest if (nearest >= begins).all() and (nearest < ends).all() else None


def _words(codes: Array, begins: Array, ends: Array, longest: int) -> Array | None:
    """The texts between places, as byte strings [n]; None where one is empty or too long."""
    length = ends - begins
    if (length < 1).any() or (length > longest).any():
        return None
    along = np.arange(int(length.max()))
    inside = along < length[:, None]
    letters = np.where(inside, codes[np.minimum(begins[:, None] + along, len(codes) - 1)], 0).astype(np.uint8)
    return letters.view(f"S{letters.shape[1]}")[:, 0]


def _stamps(codes: Array, begins: Array, ends: Array) -> Array | None:
    words = _words(codes, begins, ends, _LONGEST_STAMP)
    if words is None:
        return None
    letters = words.view(np.uint8).reshape(len(words), -1)
    points = (letters == ord(".")).sum(axis=1)
    digits = ((letters >= ord("0")) & (letters <= ord("9"))).sum(axis=1)
    dots = (codes[begins] == ord(".")) | (codes[ends - 1] == ord("."))
    if (points != 1).any() or (points + digits != ends - begins).any() or dots.any():
        return None
    return words.astype(np.float64)


class LineLabels(NamedTuple):
    """Channel and id of each line: the number of its name, all names, and the error flag of each name."""

    name_numbers: Array
    names: tuple[Name, ...]
    error_flags: Array


def _labels(codes: Array, begins: Array, ends: Array) -> LineLabels | None:
    """The part of each line between its stamp and its data."""
    words = _words(codes, begins, ends, _LONGEST_LABEL)
    if words is None:
        return None
    labels, name = np.unique(words, return_inverse=True)
    names, errors = [], []
    for label in labels.tolist():
        match = _LABEL.fullmatch(label.decode("ascii", "replace"))
        if match is None or not label.isascii():
            return None
        number, extended = int(match[2], 16), len(match[2]) == 8
        error = extended and bool(number & _ERROR_BIT)
        errors.append(ERROR if error else 0)
        names.append((match[1], number & _ID_MASK | (EXTENDED_BIT if extended and not error else 0)))
    return LineLabels(name.reshape(-1), tuple(names), np.array(errors, dtype=np.uint8))


def _payloads(codes: Array, begins: Array, lines: Array) -> tuple[Payloads, Array] | None:
    """(payloads, flags) of what stands behind the first #; lines: where the lines end."""
    ends = _data_ends(codes, begins, lines)
    if ends is None:
        return None
    fd = codes[begins] == ord("#")
    if (_NIBBLES[codes[np.minimum(begins + 1, lines)]][fd] > 15).any():
        return None
    begins = np.where(fd, begins + 2, begins)
    remote = (codes[np.minimum(begins, lines)] | 0x20) == ord("r")
    length = np.where(remote, 0, ends - begins)
    if remote.any() and not _are_remote(codes, begins[remote], ends[remote]):
        return None
    if (length < 0).any() or (length % 2).any() or (length > 2 * _MOST_BYTES).any():
        return None
    size = length // 2
    along = np.arange(max(1, int(size.max())))
    inside = along < size[:, None]
    offsets = np.minimum(begins[:, None] + 2 * along, len(codes) - 2)
    high, low = _NIBBLES[codes[offsets]], _NIBBLES[codes[offsets + 1]]
    if ((high | low)[inside] > 15).any():
        return None
    data = np.where(inside, high << 4 | low & 15, PAD).astype(np.uint8)
    return Payloads(data, size), np.where(fd, FD, 0).astype(np.uint8) | np.where(remote, RTR, 0).astype(np.uint8)


def _data_ends(codes: Array, begins: Array, lines: Array) -> Array | None:
    """Where the data end: at the line's end, before ` R` or ` T`, or before a carriage return."""
    lines = np.where(codes[lines - 1] == ord("\r"), lines - 1, lines)
    letter = codes[lines - 1]
    has_direction = (codes[lines - 2] == ord(" ")) & ((letter == ord("R")) | (letter == ord("T")))
    ends = np.where(has_direction, lines - 2, lines)
    return ends if (ends >= begins).all() else None


def _are_remote(codes: Array, begins: Array, ends: Array) -> bool:
    """Whether what begins with R is `R` or `R` and one digit."""
    length = ends - begins
    digit = _NIBBLES[codes[np.minimum(begins + 1, len(codes) - 1)]] <= 15
    return bool(((length == 1) | ((length == 2) & digit)).all())
