"""Mistakes and failures, as a tree. Outcomes of a drive (diverged, left the lane) are data, not exceptions.

TunefreeError
├── InputError      2   what the user gave does not fit: file, key, what was expected, what to do
├── BenchError      3   the bench failed: a node lost, a time-out, a bus that refused
│   ├── PeerGone        a peer of the bus is gone; carries its name
│   └── NoAnswer        a peer is there but does not answer in time
└── NotValid        4   finished, but the result must not be used (was not real time)

The number is the exit status (docs/reference/files.md).
"""

from __future__ import annotations


class TunefreeError(Exception):
    """Base of all. `code` is a short constant word for machines, the rest is for a person."""

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
    """What the user gave does not fit."""

    exit_status = 2


class BenchError(TunefreeError):
    """The bench failed."""

    exit_status = 3


class PeerGone(BenchError):
    """A peer of the bus is gone. `peer` is the name it gave at hello."""

    def __init__(self, peer: str, message: str = "", **more: str) -> None:
        super().__init__(message or f"{peer} is gone from the bus", **more)
        self.peer = peer


class NoAnswer(BenchError):
    """A peer does not answer within the hard limit."""


class NotValid(TunefreeError):
    """Finished, but not valid."""

    exit_status = 4
