"""Floor 8: the command line. Parses arguments, runs a job of jobs/ and shows its events.

Only what ends a command in order is imported here: its own modules take a while, and Ctrl-C may come in that while.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of `tunefree-hil`; leaves with the exit status of interfaces 1."""
    try:
        end_as_ctrl_c()
        from tunefree_hil.cli.entry import run

        status = run(sys.argv[1:] if arguments is None else list(arguments))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        status = INTERRUPTED
    sys.exit(status)


def end_as_ctrl_c() -> None:
    """A kill ends like Ctrl-C: processes stopped, state saved."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _end)


def _end(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


__all__ = ["INTERRUPTED", "end_as_ctrl_c", "main"]
