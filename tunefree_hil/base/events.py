"""Events of a job for its caller: the command line, a terminal app or a test."""

from __future__ import annotations

from typing import Any, NamedTuple


class Event(NamedTuple):
    """kind: 'note' (one line), 'warning', 'progress' (data: done, total, eta_s, ...), 'line' (output for
    stdout), 'result' (the last one). data['resume'] of any event: the command that continues after Ctrl-C.

    The data of a result: `sentence`, `next` (commands to paste), `status` and the content of `--json`.
    """

    kind: str
    message: str
    data: dict[str, Any] = {}  # noqa: RUF012 - never mutated
