"""The exceptions of the package. Outcomes of a drive (diverged, left the lane) are data, not exceptions.

TunefreeError
├── InputError      2   the user's input is not valid: file, key, expectation, remedy
├── BenchError      3   the bench failed: a node ended, a time-out, a bus error
│   ├── PeerGone        a peer of the bus has ended; contains its name
│   └── NoAnswer        a peer does not answer in time
└── NotValid        4   finished, but the result must not be used (not real time)

The number is the exit status (docs/reference/files.md).
"""

from __future__ import annotations


class TunefreeError(Exception):
    """Base of all. `code` is a short constant for programs, the rest is for the user."""

    exit_status = 1

    def __init__(self, message: str, *, code: str = "", file: str = "", key: str = "", hint: str = "") -> None:
        super().__init__(message)
        self.code = code or type(self).__name__
        self.message = message
        self.file = file
        self.key = key
        self.hint = hint

    def __str__(self) -> str:
        where = self.file + (f", key {self.key}" if self.key else "")
        text = f"{where}: {self.message}" if where else self.message
        return f"{text}\n  what to do: {self.hint}" if self.hint else text

    def as_dict(self) -> dict[str, str]:
        """The entry of `errors` in the JSON result (docs/reference/files.md)."""
        return {"code": self.code, "file": self.file, "key": self.key, "message": self.message, "hint": self.hint}


class InputError(TunefreeError):
    """The user's input is not valid."""

    exit_status = 2


class BenchError(TunefreeError):
    """The bench failed."""

    exit_status = 3


class PeerGone(BenchError):
    """A peer of the bus has ended. `peer` is the name in its hello."""

    def __init__(self, peer: str, message: str = "", **more: str) -> None:
        super().__init__(message or f"{peer} is gone from the bus", **more)
        self.peer = peer


class NoAnswer(BenchError):
    """A peer does not answer within the hard limit."""


class NotValid(TunefreeError):
    """Finished, but not valid."""

    exit_status = 4
