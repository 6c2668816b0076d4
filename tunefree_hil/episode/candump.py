"""Fast reader of candump text logs (`candump -L` / `-l`), and a writer.

A line: `(12.340000) vcan0 062#0011` ; FD `123##1AABB` (one flag digit); remote `123#R4`; error frames have bit 29 of
the id set; 8 hex digits mean an extended id; ` R` or ` T` (sent) may follow.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.rows import LONGEST_LINE, SENT, Row, Survey, survey

FD, BRS, ESI, RTR, ERROR = 1, 2, 4, 8, 16  # flags; the first four as in docs/reference/bench_channel.md
EXTENDED_BIT = 0x80000000  # SocketCAN's EFF: marks a 29-bit id

_ERROR_BIT = 0x20000000
_ID_MASK = 0x1FFFFFFF
_HEX = "[0-9A-Fa-f]"
_LINE = rf"\((\d+\.\d+)\) +(\S+) +({_HEX}{{8}}|{_HEX}{{3}})#(#{_HEX})?({_HEX}*|[Rr]{_HEX}?)(?: +([RT]))?[ \t\r]*"
_LINES = re.compile(rf"^{_LINE}$", re.MULTILINE)
_ONE_LINE = re.compile(_LINE)
_SCREEN = re.compile(r"\s*(\(\S+\)\s+)?\S+\s+[0-9A-Fa-f]{3,8}\s+\[\d+\]")
BLOCK_BYTES = 1 << 20  # of text parsed at once
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
    with file and line for a log that is missing, empty, cut off or not a candump log.
    """
    return [frame for frame, _ in _parse(_blocks_of(path), str(path), allow_cut)]


def read_rows(path: Path, *, allow_cut: bool = False) -> Iterator[Row]:
    """As read_candump, one by one, with the direction and the length of remote frames, for other formats."""
    for frame, groups in _parse(_blocks_of(path), str(path), allow_cut):
        flags = frame[4] | SENT if groups[5] == "T" else frame[4]
        yield Row(*frame[:4], flags, _requested_length(groups[4]) if flags & RTR else 0)


def write_candump(path: Path, rows: Iterable[Row], surveyed: Survey | None = None) -> None:
    """Write rows as a log that candump's own tools read (canplayer takes six or nine decimals).

    Nine where a stamp is finer than a microsecond. Directions are written when a frame was sent. surveyed: the survey
    of these rows; without it they are read twice.
    """
    if surveyed is None:
        rows = list(rows)
        surveyed = survey(rows)
    digits = 6 if surveyed.micro else 9
    ids: dict[tuple[int, int], str] = {}
    with path.open("w", encoding="ascii", newline="\n") as file:
        for row in rows:
            key = row.can_id, row.flags & ERROR
            name = ids.get(key) or ids.setdefault(key, _digits(*key))
            direction = (" T" if row.flags & SENT else " R") if surveyed.sent else ""
            file.write(f"({row.time_s:.{digits}f}) {row.channel} {name}#{_payload(row)}{direction}\n")


def _digits(can_id: int, error: int) -> str:
    if error:
        return f"{_ERROR_BIT | can_id & _ID_MASK:08X}"
    return f"{can_id & _ID_MASK:08X}" if can_id & EXTENDED_BIT else f"{can_id:03X}"


def _payload(row: Row) -> str:
    if row.flags & RTR:
        return f"R{row.dlc:X}" if row.dlc else "R"
    fd = f"#{row.flags >> 1 & 3:X}" if row.flags & FD else ""
    return fd + row.data.hex().upper()


def _requested_length(text: str) -> int:
    """The length that a remote frame asks for: 'R4' -> 4."""
    return int(text[1:] or "0", 16)


def cut_line(path: Path) -> str:
    """The rest of a last line that was cut off, '' for a complete log."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(0, size - LONGEST_LINE))
        tail = file.read()
    return tail.rpartition(b"\n")[2].decode("ascii", "replace")


def _blocks_of(path: Path) -> Iterator[str]:
    """The text in pieces of whole lines; only the last may lack its end."""
    if not path.is_file():
        raise InputError("there is no such log", code="no_log", file=str(path), hint="check the path")
    rest, done = b"", 0
    with path.open("rb") as file:
        while piece := file.read(BLOCK_BYTES):
            whole, end, rest_of_piece = piece.rpartition(b"\n")
            block, rest = (rest + whole + end, rest_of_piece) if end else (b"", rest + piece)
            if len(rest) > LONGEST_LINE:
                block, rest = block + rest, b""  # no log has such a line: the parser reports it
            yield _ascii(block, done, path)
            done += len(block)
    yield _ascii(rest, done, path)


def _ascii(block: bytes, done: int, path: Path) -> str:
    try:
        return block.decode("ascii")
    except UnicodeDecodeError as error:
        message = f"not a text log (byte {done + error.start} is not ASCII)"
        raise InputError(message, code="foreign_log", file=str(path), hint=_HINT) from None


Groups = tuple[str, ...]  # of one line, by _LINE


def _parse(blocks: Iterable[str], file: str, allow_cut: bool) -> Iterator[tuple[LogFrame, Groups]]:
    """Each frame with the groups of its line. A block is whole lines; only the last may lack its end."""
    lines, good, rest = 0, 0, ""
    for block in blocks:
        if rest:
            raise _problem(file, lines + 1, f"not a frame: {rest[:60]!r}", "foreign_log" if not good else "bad_line")
        text, _, rest = block.rpartition("\n")
        text += "\n" if text else ""
        groups: list[Groups] = _LINES.findall(text)
        count = text.count("\n")
        if len(groups) != count:
            _explain(text, file, lines, good or len(groups))
        try:
            frames = _frames(groups)
        except ValueError:
            raise _odd_data(text, file, lines) from None
        yield from zip(frames, groups, strict=True)
        lines, good = lines + count, good + len(groups)
    if rest and not allow_cut:
        raise _problem(file, lines + 1, f"the log is cut off in this line: {rest[:60]!r}", "truncated_log")
    if not good:
        raise InputError("the log is empty: there is not one frame in it", code="empty_log", file=file, hint=_HINT)


def _frames(found: list[tuple[str, ...]]) -> list[LogFrame]:
    """Make frames of the regular expression's groups. ValueError for an odd number of data digits."""
    ids = {digits: _identify(digits) for digits in {groups[2] for groups in found}}
    frames = []
    from_hex, make = bytes.fromhex, tuple.__new__  # the constructor of a named tuple takes three times as long
    for time, channel, digits, fd, data, _ in found:
        can_id, flags = ids[digits]
        if fd:
            flags |= FD | (int(fd[1], 16) & 3) << 1
        if data and data[0] in "Rr":
            flags |= RTR
            data = ""
        frames.append(make(LogFrame, (float(time), channel, can_id, from_hex(data), flags)))
    return frames


def _identify(digits: str) -> tuple[int, int]:
    """(can_id, flags) of an id's digits."""
    number = int(digits, 16)
    if len(digits) == 3:
        return number, 0
    if number & _ERROR_BIT:
        return number & _ID_MASK, ERROR
    return number & _ID_MASK | EXTENDED_BIT, 0


def _explain(text: str, file: str, before: int, good: int) -> None:
    """Raise the error of the first line that is not a frame; blank lines are allowed. before: lines before the text."""
    for number, line in enumerate(text.splitlines(), before + 1):
        if not line.strip() or _ONE_LINE.fullmatch(line):
            continue
        if good == 0 and _SCREEN.match(line):
            raise _problem(file, number, "this is what candump shows on a screen, not its log format", "foreign_log")
        problem = "not a candump log" if good == 0 else "not a frame"
        raise _problem(file, number, f"{problem}: {line[:60]!r}", "foreign_log" if good == 0 else "bad_line")


def _odd_data(text: str, file: str, before: int) -> InputError:
    for number, line in enumerate(text.splitlines(), before + 1):
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
