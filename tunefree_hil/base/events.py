"""What a job tells whoever runs it: the command line prints it, a terminal app draws it, a test lists it."""

from __future__ import annotations

from typing import Any, NamedTuple


class Event(NamedTuple):
    """kind: 'note' (one line), 'warning', 'progress' (data: done, total, eta_s, ...), 'line' (a job's product, for
    stdout), 'result' (the last one). data['resume'] of any event: the command that goes on after Ctrl-C.

    A result's data holds `sentence`, `next` (commands that work as pasted), `status` and whatever `--json` gives.
    """

    kind: str
    message: str
    data: dict[str, Any] = {}  # noqa: RUF012 - never mutated
