"""Fast reader of candump text logs (`candump -L` / `-l`), ours and anybody's, and a writer.

A line: `(12.340000) vcan0 062#0011` ; FD `123##1AABB` (one flag digit); remote `123#R4`; error frames have bit 29 of
the id set; 8 hex digits mean an extended id; ` R` or ` T` (sent) may follow (can_hil_anchors A9).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.rows import SENT, Row

FD, BRS, ESI, RTR, ERROR = 1, 2, 4, 8, 16  # flags; the first four as in interfaces 8
EXTENDED_BIT = 0x80000000  # SocketCAN's EFF: tells the 29-bit id from the 11-bit id of the same number

_ERROR_BIT = 0x20000000
_ID_MASK = 0x1FFFFFFF
_HEX = "[0-9A-Fa-f]"
_LINE = rf"\((\d+\.\d+)\) +(\S+) +({_HEX}{{8}}|{_HEX}{{3}})#(#{_HEX})?({_HEX}*|[Rr]{_HEX}?)(?: +([RT]))?[ \t\r]*"
_LINES = re.compile(rf"^{_LINE}$", re.MULTILINE)
_ONE_LINE = re.compile(_LINE)
_EXACT_S = 2e-9  # beyond the microsecond, and beyond what a double holds of an epoch time, a stamp needs nine decimals
_SCREEN = re.compile(r"\s*(\(\S+\)\s+)?\S+\s+[0-9A-Fa-f]{3,8}\s+\[\d+\]")
_HINT = "record with `candump -l CHANNEL`, or the bench's own vehicle.log"


class LogFrame(NamedTuple):
    """One frame of a log. can_id: SocketCAN's, EFF bit included; flags: FD 1, BRS 2, ESI 4, RTR 8, error frame 16."""

    time_s: float
    channel: str
    can_id: int
    data: bytes
    flags: int = 0


def read_candump(path: Path, *, allow_cut: bool = False) -> list[LogFrame]:
    """All frames of a log, in the file's order.

    `allow_cut`: a last line that was cut off (a run that was killed) is left out instead of refused. Raises InputError
    with file and line for a log that is missing, empty, cut off or no candump log at all.
    """
    return parse_candump(_text_of(path), str(path), allow_cut=allow_cut)


def read_rows(path: Path, *, allow_cut: bool = False) -> list[Row]:
    """As read_candump, with what only other formats ask for: direction, and the length of remote frames."""
    return [
        Row(*frame[:4], frame.flags | (SENT if groups[5] == "T" else 0), _asked(groups[4]) if frame.flags & RTR else 0)
        for frame, groups in _parse(_text_of(path), str(path), allow_cut)
    ]


def write_candump(path: Path, rows: Iterable[Row]) -> None:
    """Write rows as a log that candump's own tools read (canplayer takes six or nine decimals).

    Nine where a stamp is finer than a microsecond. Directions are written when a frame was sent.
    """
    rows = list(rows)
    digits = 6 if all(_is_micro(row.time_s) for row in rows) else 9
    ways = any(row.flags & SENT for row in rows)
    ids = {key: _digits(*key) for key in {(row.can_id, row.flags & ERROR) for row in rows}}
    with path.open("w", encoding="ascii", newline="\n") as file:
        for row in rows:
            way = (" T" if row.flags & SENT else " R") if ways else ""
            name = ids[row.can_id, row.flags & ERROR]
            file.write(f"({row.time_s:.{digits}f}) {row.channel} {name}#{_payload(row)}{way}\n")


def _is_micro(time_s: float) -> bool:
    return abs(time_s - round(time_s, 6)) <= max(_EXACT_S, math.ulp(time_s))


def _digits(can_id: int, error: int) -> str:
    if error:
        return f"{_ERROR_BIT | can_id & _ID_MASK:08X}"
    return f"{can_id & _ID_MASK:08X}" if can_id & EXTENDED_BIT else f"{can_id:03X}"


def _payload(row: Row) -> str:
    if row.flags & RTR:
        return f"R{row.dlc:X}" if row.dlc else "R"
    fd = f"#{row.flags >> 1 & 3:X}" if row.flags & FD else ""
    return fd + row.data.hex().upper()


def _asked(text: str) -> int:
    """The length that a remote frame asks for: 'R4' -> 4."""
    return int(text[1:] or "0", 16)


def parse_candump(text: str, file: str, *, allow_cut: bool = False) -> list[LogFrame]:
    """As read_candump, of a text; `file` is what errors name."""
    return [frame for frame, _ in _parse(text, file, allow_cut)]


def _parse(text: str, file: str, allow_cut: bool) -> list[tuple[LogFrame, tuple[str, ...]]]:
    """Each frame with the groups of its line."""
    if text and not text.endswith("\n"):
        whole, _, rest = text.rpartition("\n")
        if not allow_cut:
            raise _problem(
                file, text.count("\n") + 1, f"the log is cut off in this line: {rest[:60]!r}", "truncated_log"
            )
        text = whole + "\n" if whole else ""
    found = _LINES.findall(text)
    if len(found) != text.count("\n"):
        _explain(text, file, len(found))
    if not found:
        raise InputError("the log is empty: there is not one frame in it", code="empty_log", file=file, hint=_HINT)
    try:
        return list(zip(_frames(found), found, strict=True))
    except ValueError:
        raise _odd_data(text, file) from None


def _frames(found: list[tuple[str, ...]]) -> list[LogFrame]:
    """Make frames of the regular expression's groups. ValueError for an odd number of data digits."""
    ids = {digits: _identify(digits) for digits in {groups[2] for groups in found}}
    frames = []
    from_hex, make = bytes.fromhex, LogFrame._make
    for time, channel, digits, fd, data, _ in found:
        can_id, flags = ids[digits]
        if fd:
            flags |= FD | (int(fd[1], 16) & 3) << 1
        if data and data[0] in "Rr":
            flags |= RTR
            data = ""
        frames.append(make((float(time), channel, can_id, from_hex(data), flags)))
    return frames


def _identify(digits: str) -> tuple[int, int]:
    """(can_id, flags) of an id's digits."""
    number = int(digits, 16)
    if len(digits) == 3:
        return number, 0
    if number & _ERROR_BIT:
        return number & _ID_MASK, ERROR
    return number & _ID_MASK | EXTENDED_BIT, 0


def _text_of(path: Path) -> str:
    if not path.is_file():
        raise InputError("there is no such log", code="no_log", file=str(path), hint="check the path")
    try:
        return path.read_bytes().decode("ascii")
    except UnicodeDecodeError as error:
        raise InputError(
            f"not a text log (byte {error.start} is not ASCII)", code="foreign_log", file=str(path), hint=_HINT
        ) from None


def _explain(text: str, file: str, good: int) -> None:
    """Raise the error of the first line that is not a frame; blank lines are no fault."""
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or _ONE_LINE.fullmatch(line):
            continue
        if good == 0 and _SCREEN.match(line):
            raise _problem(file, number, "this is what candump shows on a screen, not its log format", "foreign_log")
        what = "not a candump log" if good == 0 else "not a frame"
        raise _problem(file, number, f"{what}: {line[:60]!r}", "foreign_log" if good == 0 else "bad_line")


def _odd_data(text: str, file: str) -> InputError:
    for number, line in enumerate(text.splitlines(), 1):
        match = _ONE_LINE.fullmatch(line)
        if match and len(match[5]) % 2 and match[5][0] not in "Rr":
            return _problem(file, number, f"odd number of data digits: {line[:60]!r}", "bad_line")
    return InputError("a frame's data cannot be read", code="bad_line", file=file, hint=_HINT)


def _problem(file: str, line: int, message: str, code: str) -> InputError:
    hint = {
        "truncated_log": "delete the last line to use what is before it",
        "bad_line": "delete this line, or record the drive again",
    }.get(code, _HINT)
    return InputError(message, code=code, file=f"{file}:{line}", hint=hint)
