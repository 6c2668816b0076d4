"""Progress for a person at a terminal: two lines that stay in place, redrawn at most five times a second."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from tunefree_hil.base.events import Event
from tunefree_hil.cli.text import counted, number, pace, scores, time_left

REDRAW_S = 0.2
BAR_COLUMNS = 30


class LiveSink:
    """Notes and warnings scroll, progress stays below them. NO_COLOR is honoured by rich."""

    def __init__(self, console: Console | None = None, now_s: Callable[[], float] = time.monotonic) -> None:
        self.console = console or Console(stderr=True, highlight=False)
        self.now_s = now_s
        self._live: Live | None = None
        self._drawn_s = float("-inf")
        self._told: float | None = None  # `done` of the last message that scrolled by

    def show(self, event: Event) -> None:
        """Draw one event."""
        if event.kind == "progress":
            self._progress(event)
        elif event.kind == "warning":
            self.console.print(Text("warning: " + event.message, style="yellow"), soft_wrap=True)
        else:
            self.console.print(Text(event.message), soft_wrap=True)

    def _progress(self, event: Event) -> None:
        done, total = number(event.data, "done"), number(event.data, "total")
        if event.message and total is not None and done != self._told:  # one line that stays for each thing done
            self._told = done
            self.console.print(Text(event.message), soft_wrap=True)
        last = done is not None and done == total
        if self.now_s() - self._drawn_s < REDRAW_S and not last:
            return
        self._drawn_s = self.now_s()
        if self._live is None:
            self._live = Live(console=self.console, auto_refresh=False, transient=True)
            self._live.start()
        self._live.update(picture(event.message, event.data), refresh=True)

    def close(self) -> None:
        """Take the bars away and give the cursor back."""
        if self._live is not None:
            self._live.stop()
            self._live = None


def picture(message: str, data: Mapping[str, Any]) -> RenderableType:
    """How far (bar, count, time left), how well and how fast; then the lines of `block`, a map that stays in place."""
    first = Table.grid(padding=(0, 2))
    done, total = number(data, "done"), number(data, "total")
    bar = ProgressBar(total=total, completed=done or 0.0, width=BAR_COLUMNS) if total else Text(message)
    first.add_row(Text(counted(data)), bar, Text(time_left(data)))
    second = ", ".join(part for part in (scores(data), pace(data)) if part)
    block = [Text(str(line), no_wrap=True, overflow="ellipsis") for line in data.get("block", ())]
    return Group(first, Text(second, no_wrap=True, overflow="ellipsis"), *block)
