"""The finalisation of a shared study: work that one worker does for all of them when every slot is filled.

It is leased like a slot. Its results are stored with the study, together with an id of the trials that they belong to;
the other workers wait for them and use them. If the worker ends before it has stored them, its lease expires on the
server, and a waiting worker or the next one that is started takes over.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Generator, Sequence
from typing import Any, Self, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from tunefree_hil.tune.shared import server
from tunefree_hil.tune.shared.shared_study import POLL_S, SharedStudy
from tunefree_hil.tune.shared.slot_leases import Heartbeat

FINALISATION_SLOT = -1  # in the table of leases; the slots begin at 0
WORKER = "worker"  # key of the worker that stored the first part
TRIALS_ID = "of"  # key
R = TypeVar("R")


class Finalisation:
    """Context manager. After `wait_for_parts`, `parts` are stored, and with `is_ours` this worker does the others."""

    def __init__(self, study: SharedStudy, trials_id: str) -> None:
        self.study = study
        self.trials_id = trials_id
        self.parts: dict[str, Any] = {}
        self.is_ours = False
        self._heartbeat: Heartbeat | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Release the lease: another worker may do what is missing."""
        if self._heartbeat is None:
            return
        self._heartbeat.__exit__(None, None, None)
        with contextlib.suppress(SQLAlchemyError):  # on a server that is unreachable the lease expires
            self.study.leases.release(FINALISATION_SLOT)

    def wait_for_parts(self, wanted: Sequence[str]) -> Generator[str, None, None]:
        """Wait until all parts or the first one are stored, or until this worker does the missing ones.

        Args:
            wanted: Names of the parts, in the order in which they are stored.

        Yields:
            Messages for the user.
        """
        is_waiting = False
        while True:
            yield from self._retry(self._read)
            if not self._is_missing(wanted):
                return
            self.is_ours = yield from self._retry(lambda: self._acquire(wanted))
            if self.is_ours or wanted[0] in self.parts:
                return
            if self._is_missing(wanted) and not is_waiting:
                yield "all slots are filled; waiting for the worker that determines the winner"
                is_waiting = True
            time.sleep(POLL_S)

    def store_parts(self, **parts: Any) -> Generator[str, None, None]:
        """Store results; parts that another worker has already stored stay unchanged. Yields messages."""
        yield from self._retry(lambda: self._store(parts))

    def _is_missing(self, wanted: Sequence[str]) -> bool:
        return any(part not in self.parts for part in wanted)

    def _read(self) -> None:
        stored = self.study.shared_trials.read_finalisation()
        self.parts = stored if stored.get(TRIALS_ID) == self.trials_id else {}

    def _acquire(self, wanted: Sequence[str]) -> bool:
        """Take the lease, unless another worker has it or has stored all parts."""
        if not self.study.leases.acquire(FINALISATION_SLOT):
            return False
        self._read()
        if not self._is_missing(wanted):
            self.study.leases.release(FINALISATION_SLOT)
            return False
        self._heartbeat = self.study.leases.keep_renewed(FINALISATION_SLOT).__enter__()
        return True

    def _store(self, parts: dict[str, Any]) -> None:
        with server.advisory_lock(self.study.leases.engine):
            self._read()
            self.parts = {TRIALS_ID: self.trials_id, WORKER: self.study.leases.worker, **parts, **self.parts}
            self.study.shared_trials.store_finalisation(self.parts)

    def _retry(self, action: Callable[[], R]) -> Generator[str, None, R]:
        return (yield from server.retry_while_unreachable(action, self.study.address, self.study.patience_s))
