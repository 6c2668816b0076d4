"""Floor 8: the command line. It parses arguments, runs a job of jobs/ and shows its events.

Only what a command needs to end orderly is imported here: Ctrl-C may come while the other modules are imported.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of `tunefree-hil`; the exit status is that of docs/reference/files.md."""
    try:
        handle_sigterm()
        from tunefree_hil.cli.entry import run

        status = run(sys.argv[1:] if arguments is None else list(arguments))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        status = INTERRUPTED
    if arguments is None:
        ignore_signals()
    sys.exit(status)


def handle_sigterm() -> None:
    """Make SIGTERM end a command like Ctrl-C: processes are stopped, state is saved."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _raise_interrupt)


def ignore_signals() -> None:
    """Keep the exit status: Python hands SIGINT back to the system as it ends, and a late Ctrl-C would be reported."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _raise_interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


__all__ = ["INTERRUPTED", "handle_sigterm", "ignore_signals", "main"]
