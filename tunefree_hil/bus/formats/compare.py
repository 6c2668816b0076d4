"""Checks that a written log reads back: two streams of frames side by side; only moved frames take memory."""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import defaultdict
from collections.abc import Iterable
from itertools import zip_longest
from pathlib import Path

from tunefree_hil.base.errors import BenchError
from tunefree_hil.bus.formats.rows import EXACT_S, TICK_S, FormatLoss, Row

Content = tuple[str, int, bytes, int, int]  # a Row without its stamp
Waiting = defaultdict[Content, list[float]]  # sorted stamps of frames that have no partner yet


class Proof:
    """Pairs each frame that was written with one that was read: same content, less than TICK_S apart.

    frames: pairs found; moved: places at which the two streams differ; rounded, most_s: stamps that changed, and by how
    much at most.
    """

    def __init__(self) -> None:
        self.frames = self.moved = self.rounded = 0
        self.most_s = 0.0
        self._wanted: Waiting = defaultdict(list)
        self._found: Waiting = defaultdict(list)

    def compare(self, written: Iterable[Row], read_back: Iterable[Row]) -> None:
        """Go through both streams to their ends."""
        for a, b in zip_longest(written, read_back):
            if a is not None and b is not None and a[1:] == b[1:] and abs(a[0] - b[0]) < TICK_S:
                self._pair(a[0], b[0])
                continue
            self.moved += a is not None and b is not None and a[1:] != b[1:]
            if a is not None:
                self._seek(a, self._found, self._wanted)
            if b is not None:
                self._seek(b, self._wanted, self._found)

    def _seek(self, row: Row, others: Waiting, waiting: Waiting) -> None:
        """Pair a row with one that waits in the other stream, or add it to the waiting rows."""
        content: Content = row[1:]
        times = others[content]
        place = bisect_left(times, row.time_s - TICK_S)
        if place < len(times) and abs(times[place] - row.time_s) < TICK_S:
            self._pair(row.time_s, times.pop(place))
        else:
            insort(waiting[content], row.time_s)
        if not times:
            del others[content]

    def _pair(self, a_s: float, b_s: float) -> None:
        self.frames += 1
        off_s = abs(a_s - b_s)
        if off_s > EXACT_S and off_s > 2.0 * math.ulp(a_s):
            self.rounded += 1
            self.most_s = max(self.most_s, off_s)

    def refuse_different(self, target: Path) -> None:
        """Raise BenchError unless the same frames came back, each within a microsecond of its time."""
        for content in [*self._wanted, *self._found]:
            raise BenchError(
                f"what was written does not read back: of frame 0x{content[1] & 0x1FFFFFFF:X} on {content[0]} "
                f"{len(self._wanted.get(content, []))} went in and did not come back, "
                f"{len(self._found.get(content, []))} came back and had not gone in",
                code="conversion",
                file=str(target),
                hint="nothing was left there; report this log",
            )

    def losses(self) -> list[FormatLoss]:
        """Frames that changed places with others of the same time, and stamps that were rounded."""
        losses = []
        if self.moved:
            text = "comes in another place, for the format keeps frames in the order of time only"
            losses.append(FormatLoss(self.moved, text))
        if self.rounded:
            losses.append(FormatLoss(self.rounded, f"the stamp is rounded, by at most {1e6 * self.most_s:.3f} us"))
        return losses
