"""The end of a shared study: what one worker does for all when every slot is filled, claimed as a slot is.

What it found is kept with the study, under the trials that it is about; other workers wait for it and go by it. A
worker that dies at it is followed by one that waits, or by the next that is started: by the server's clock, not by who
filled the last slot.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Generator, Sequence
from typing import Any, Self, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from tunefree_hil.tune.shared import server
from tunefree_hil.tune.shared.shared_study import POLL_S, SharedStudy
from tunefree_hil.tune.shared.slot_leases import Pulse

CLAIM = -1  # in the table of claims, beside the slots from 0 on
WORKER = "worker"  # who found the first part
R = TypeVar("R")


class Ending:
    """Context manager. After `look`: `kept`, the parts that are there; `ours`, whether the rest is ours to do."""

    def __init__(self, study: SharedStudy, of: str) -> None:
        self.study = study
        self.of = of
        self.kept: dict[str, Any] = {}
        self.ours = False
        self._pulse: Pulse | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Give the claim back: what is missing is somebody else's from now on."""
        if self._pulse is None:
            return
        self._pulse.__exit__(None, None, None)
        with contextlib.suppress(SQLAlchemyError):  # a server that is gone: the claim expires there by itself
            self.study.claims.leave(CLAIM)

    def look(self, wanted: Sequence[str]) -> Generator[str, None, None]:
        """Wait until all of `wanted` is there, what is missing is ours, or only later parts are left to another worker.

        Yields sentences for a person.
        """
        waiting = False
        while True:
            yield from self._patiently(self._read)
            if not self._missing(wanted):
                return
            self.ours = yield from self._patiently(lambda: self._take(wanted))
            if self.ours or wanted[0] in self.kept:
                return
            if self._missing(wanted) and not waiting:
                yield "all slots are filled; waiting for the worker that finds out who wins"
                waiting = True
            time.sleep(POLL_S)

    def keep(self, **parts: Any) -> Generator[str, None, None]:
        """Store what was found; where another worker did so meanwhile, its answer counts."""
        yield from self._patiently(lambda: self._keep(parts))

    def _missing(self, wanted: Sequence[str]) -> bool:
        return any(part not in self.kept for part in wanted)

    def _read(self) -> None:
        stored = self.study.slots.ending()
        self.kept = stored if stored.get("of") == self.of else {}

    def _take(self, wanted: Sequence[str]) -> bool:
        """Claim it, unless a living worker has it or has just done it."""
        if not self.study.claims.take(CLAIM):
            return False
        self._read()
        if not self._missing(wanted):
            self.study.claims.leave(CLAIM)
            return False
        self._pulse = self.study.claims.alive(CLAIM).__enter__()
        return True

    def _keep(self, parts: dict[str, Any]) -> None:
        with server.one_at_a_time(self.study.claims.engine):
            self._read()
            self.kept = {"of": self.of, WORKER: self.study.claims.worker, **parts, **self.kept}
            self.study.slots.keep_ending(self.kept)

    def _patiently(self, work: Callable[[], R]) -> Generator[str, None, R]:
        return (yield from server.patiently(work, self.study.address, self.study.patience_s))
