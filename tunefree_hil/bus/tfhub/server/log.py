"""The hub's log: candump text, `(sec.usec) CHANNEL ID#DATA`, in the order of the bus.

Readable by `can.LogReader`, `cantools decode` and `canplayer`. Routing only keeps the bytes; they become text in idle
moments, in small slices, and at the end.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Mapping
from typing import BinaryIO

from tunefree_hil.base.errors import BenchError
from tunefree_hil.bus.tfhub.records import (
    BRS,
    DATA_AT,
    EFF_FLAG,
    EFF_MASK,
    ERR_FLAG,
    ESI,
    FD,
    FRAME_HEAD,
    NO_CLASS,
    RTR_FLAG,
    SFF_MASK,
)

FLUSH_LINES = 2000  # about 64 KiB
MOST_IDS = 4096  # ids whose text is kept; a tool that tries all 29 bits must not fill the memory


def id_text(can_id: int) -> str:
    """The id as candump writes it: 3 hex digits, 8 when extended or an error frame."""
    if can_id & ERR_FLAG:
        return f"{ERR_FLAG | (can_id & EFF_MASK or NO_CLASS):08X}"
    if can_id & EFF_FLAG:
        return f"{can_id & EFF_MASK:08X}"
    return f"{can_id & SFF_MASK:03X}"


def time_text(time_ns: int) -> str:
    """'(sec.usec)' with the six decimals that canplayer wants."""
    seconds, micros = divmod((time_ns + 500) // 1000, 1_000_000)
    return f"({seconds}.{micros:06d})"


class CandumpLog:
    """One log of one channel. `offset_ns` is added to every stamp (real clock: monotonic to wall time).

    An error of the disk is kept in `failure`, never raised while recording: the bus goes on, `close` raises it.
    """

    def __init__(self, path: str, channel: str, offset_ns: int) -> None:
        self.path = path
        self.part = path + ".part"
        self.frames = 0  # written, or to be
        self.failure = ""
        self.waiting = 0  # frames not yet text
        self._channel = channel
        self._offset_ns = offset_ns
        self._chunks: deque[tuple[bytes, int]] = deque()
        self._text: list[str] = []
        self._prefixes: dict[int, str] = {}
        self._time_ns = -1
        self._stamp = ""
        try:
            self._file: BinaryIO | None = open(self.part, "wb", buffering=0)  # noqa: SIM115 - lives until close
        except OSError as error:
            raise BenchError(f"cannot be written: {error.strerror}", code="log_failed", file=path) from error

    def add(self, chunk: bytes, frames: int) -> None:
        """Keep FRAME records for later."""
        if not self.failure:
            self._chunks.append((chunk, frames))
            self.waiting += frames
        self.frames += frames

    def work(self, frames: int) -> None:
        """Make text of about `frames` frames, and write it when it is enough."""
        while self._chunks and frames > 0:
            chunk, count = self._chunks.popleft()
            self._format(chunk)
            self.waiting -= count
            frames -= count
        if len(self._text) > FLUSH_LINES:
            self._write()

    def close(self) -> None:
        """Write the rest and give the file its name. BenchError when the disk refused any of it."""
        self.abandon()
        if not self.failure:
            try:
                os.replace(self.part, self.path)
                return
            except OSError as error:
                self.failure = error.strerror or str(error)
        raise BenchError(
            f"the log could not be written: {self.failure}",
            code="log_failed",
            file=self.path,
            hint=f"make room; what was written before lies in {self.part}",
        )

    def abandon(self) -> None:
        """Write the rest but leave the temporary name: the log of a run that was cut off."""
        self.work(self.waiting)
        self._write()
        if self._file is not None:
            self._file.close()
            self._file = None

    def discard(self) -> None:
        """Remove the log, which has not begun."""
        self.abandon()
        os.unlink(self.part)

    def _write(self) -> None:
        rest = memoryview("".join(self._text).encode("ascii"))
        self._text.clear()
        try:
            while self._file is not None and len(rest) and not self.failure:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self.failure = error.strerror or str(error)
            self._chunks.clear()
            self.waiting = 0

    def _format(self, chunk: bytes) -> None:
        """Lines of one chunk of whole FRAME records."""
        digits = chunk.hex().upper()
        text, prefixes = self._text, self._prefixes
        offset, end = 0, len(chunk)
        while offset < end:
            size, _, _, _, time_ns, can_id, length, flags = FRAME_HEAD.unpack_from(chunk, offset)
            if time_ns != self._time_ns:
                self._time_ns = time_ns
                self._stamp = time_text(time_ns + self._offset_ns)
            prefix = prefixes.get(can_id) or self._prefix(can_id)
            first = 2 * (offset + DATA_AT)
            data = digits[first : first + 2 * length]
            if size == FD.size:
                data = f"#{flags & (BRS | ESI):X}{data}"
            elif can_id & RTR_FLAG:
                data = f"R{length}" if length else "R"
            text.append(f"{self._stamp}{prefix}{data}\n")
            offset += size

    def _prefix(self, can_id: int) -> str:
        """The text between stamp and data; cached, as there are few ids."""
        if len(self._prefixes) > MOST_IDS:
            self._prefixes.clear()
        prefix = self._prefixes[can_id] = f" {self._channel} {id_text(can_id)}#"
        return prefix


def open_logs(paths: Mapping[str, str], names: Mapping[str, str], offset_ns: int) -> dict[str, CandumpLog]:
    """A log for each channel of `paths`. BenchError, and no file left, where one cannot be made."""
    logs: dict[str, CandumpLog] = {}
    try:
        for channel, path in paths.items():
            logs[channel] = CandumpLog(path, names[channel], offset_ns)
    except BenchError:
        for log in logs.values():
            log.discard()
        raise
    return logs


def close_logs(logs: Iterable[CandumpLog]) -> None:
    """Close every log; then the first BenchError of them is raised."""
    errors: list[BenchError] = []
    for log in logs:
        try:
            log.close()
        except BenchError as error:
            errors.append(error)
    if errors:
        raise errors[0]
