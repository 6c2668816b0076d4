"""Frames as comma-separated text with a head line, for spreadsheets and scripts: a line a frame, data as hex digits.

Ours, because python-can's has no CAN FD, no channel and no direction. Theirs (data in base64) is read too.
"""

from __future__ import annotations

import base64
import binascii
import csv
import math
from collections.abc import Iterable, Iterator
from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.rows import (
    BRS,
    ERROR,
    ESI,
    EXTENDED_BIT,
    FD,
    ID_MASK,
    RTR,
    SENT,
    Format,
    Row,
    Survey,
    refuse_cut,
    unreadable,
)

HEAD = ("time_s", "channel", "id", "extended", "fd", "brs", "esi", "remote", "error", "sent", "dlc", "data")
THEIR_HEAD = ("timestamp", "arbitration_id", "extended", "remote", "error", "dlc", "data")
_BITS = {"fd": FD, "brs": BRS, "esi": ESI, "remote": RTR, "error": ERROR, "sent": SENT}


def read(path: Path) -> Iterator[Row]:
    """Frames in the file's order. InputError names a malformed line."""
    refuse_cut(path)
    try:
        with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
            lines = csv.reader(file)
            head = tuple(next(lines, ()))
            if head not in (HEAD, THEIR_HEAD):
                hint = f"frames need the head {','.join(HEAD)}; for a test drive in columns use `log import`"
                raise InputError("no CSV of frames", code="foreign_log", file=f"{path}:1", hint=hint)
            yield from _rows(lines, head, path)
    except csv.Error as error:
        raise unreadable(path, "CSV", error) from error


def _rows(lines: Iterator[list[str]], head: tuple[str, ...], path: Path) -> Iterator[Row]:
    for number, cells in enumerate(lines, 2):
        if not cells:
            continue
        try:
            values = dict(zip(head, cells, strict=True))
            yield _ours(values) if head == HEAD else _theirs(values)
        except (ValueError, binascii.Error) as error:
            raise InputError(
                f"not a frame: {error}", code="bad_line", file=f"{path}:{number}", hint="delete or correct this line"
            ) from error


def _ours(values: dict[str, str]) -> Row:
    flags = sum(bit for name, bit in _BITS.items() if _yes(values[name]))
    can_id = _identifier(values)
    data = bytes.fromhex(values["data"])
    if len(data) > (64 if flags & FD else 8):
        raise ValueError(f"{len(data)} bytes of data")
    dlc = int(values["dlc"]) if flags & RTR else 0  # of a frame with data its length says it
    return Row(_stamp(values["time_s"]), values["channel"], can_id, data, flags, dlc)


def _theirs(values: dict[str, str]) -> Row:
    remote = _yes(values["remote"])
    flags = (RTR if remote else 0) | (ERROR if _yes(values["error"]) else 0)
    data = b"" if remote else base64.b64decode(values["data"], validate=True)
    return Row(
        _stamp(values["timestamp"]), "can0", _identifier(values), data, flags, int(values["dlc"]) if remote else 0
    )


def _stamp(word: str) -> float:
    time_s = float(word)
    if not math.isfinite(time_s):
        raise ValueError(f"{word!r} is no time")
    return time_s


def _identifier(values: dict[str, str]) -> int:
    can_id = int(values["id" if "id" in values else "arbitration_id"], 16)
    if not 0 <= can_id <= ID_MASK:
        raise ValueError(f"{can_id:#x} is no CAN id")
    return can_id | EXTENDED_BIT if _yes(values["extended"]) and not _yes(values["error"]) else can_id


def _yes(word: str) -> bool:
    if word not in ("0", "1"):
        raise ValueError(f"expected 0 or 1, got {word!r}")
    return word == "1"


def write(path: Path, rows: Iterable[Row], seen: Survey) -> None:
    """Write rows; stamps with all their digits."""
    with path.open("w", newline="", encoding="utf-8") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(HEAD)
        for row in rows:
            bits = {name: int(bool(row.flags & bit)) for name, bit in _BITS.items()}
            extended = int(bool(row.can_id & EXTENDED_BIT))
            front = (repr(row.time_s), row.channel, f"0x{row.can_id & ID_MASK:X}", extended)
            lines.writerow((*front, *bits.values(), row.dlc, row.data.hex().upper()))


# everything is kept
FORMAT = Format("csv", read, write, lambda rows, seen, lost: rows)
