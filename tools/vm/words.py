"""What a person is told when there is no virtual machine: one sentence and what to do, never a traceback."""

from __future__ import annotations

import sys

EXIT_VM = 3  # no machine: not installed, does not boot, died
EXIT_TIMEOUT = 124  # as coreutils' timeout


class VmError(Exception):
    """No machine, or it ended without an answer. `hint`: what to do about it."""

    def __init__(self, message: str, hint: str = "", status: int = EXIT_VM) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.status = status


def say(text: str) -> None:
    """A line on stderr, marked as ours: COMMAND's own words go there too."""
    print(f"vcan_vm: {text}", file=sys.stderr, flush=True)
