"""Progress at a terminal: two lines that stay in place, redrawn at most five times a second."""

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
from tunefree_hil.cli.text import count_text, finite_number, pace_text, scores_text, time_left_text

REDRAW_S = 0.2
BAR_COLUMNS = 30


class LiveSink:
    """Notes and warnings scroll, progress stays below them. rich respects NO_COLOR."""

    def __init__(self, console: Console | None = None, now_s: Callable[[], float] = time.monotonic) -> None:
        self.console = console or Console(stderr=True, highlight=False)
        self.now_s = now_s
        self._live: Live | None = None
        self._drawn_s = float("-inf")
        self._last_done: float | None = None  # `done` of the last message that scrolled by

    def show(self, event: Event) -> None:
        """Draw one event."""
        if event.kind == "progress":
            self._progress(event)
        elif event.kind == "warning":
            self.console.print(Text("warning: " + event.message, style="yellow"), soft_wrap=True)
        else:
            self.console.print(Text(event.message), soft_wrap=True)

    def _progress(self, event: Event) -> None:
        done, total = finite_number(event.data, "done"), finite_number(event.data, "total")
        if event.message and total is not None and done != self._last_done:  # one lasting line for each finished item
            self._last_done = done
            self.console.print(Text(event.message), soft_wrap=True)
        last = done is not None and done == total
        if self.now_s() - self._drawn_s < REDRAW_S and not last:
            return
        self._drawn_s = self.now_s()
        if self._live is None:
            self._live = Live(console=self.console, auto_refresh=False, transient=True)
            self._live.start()
        self._live.update(render_progress(event.message, event.data), refresh=True)

    def close(self) -> None:
        """Remove the bars and show the cursor again."""
        if self._live is not None:
            self._live.stop()
            self._live = None


def render_progress(message: str, data: Mapping[str, Any]) -> RenderableType:
    """Bar, count and time left; scores and speed; then the lines of `block`, such as a map."""
    first = Table.grid(padding=(0, 2))
    done, total = finite_number(data, "done"), finite_number(data, "total")
    bar = ProgressBar(total=total, completed=done or 0.0, width=BAR_COLUMNS) if total else Text(message)
    first.add_row(Text(count_text(data)), bar, Text(time_left_text(data)))
    second = ", ".join(part for part in (scores_text(data), pace_text(data)) if part)
    block = [Text(str(line), no_wrap=True, overflow="ellipsis") for line in data.get("block", ())]
    return Group(first, Text(second, no_wrap=True, overflow="ellipsis"), *block)
