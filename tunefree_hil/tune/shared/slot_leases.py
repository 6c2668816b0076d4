"""Leases on the slots of a shared study: one row a slot, taken and renewed by the clock of the server.

A lease is an INSERT that only one of two workers can make. Its worker renews the row every few seconds. A lease that
was not renewed for `grace_s` has expired: its worker has probably ended, and another worker may take it over.
"""

from __future__ import annotations

import os
import socket
import threading
import uuid
from types import TracebackType

import sqlalchemy
from sqlalchemy import text
from sqlalchemy.exc import SQLAlchemyError

GRACE_S = 20.0
RENEWALS_PER_GRACE = 5

_TABLE = """CREATE TABLE IF NOT EXISTS tunefree_claims (
    study text NOT NULL, slot integer NOT NULL, worker text NOT NULL, seen timestamptz NOT NULL,
    PRIMARY KEY (study, slot))"""
_ACQUIRE = """INSERT INTO tunefree_claims AS held (study, slot, worker, seen) VALUES (:study, :slot, :worker, now())
    ON CONFLICT (study, slot) DO UPDATE SET worker = excluded.worker, seen = now()
    WHERE held.worker = excluded.worker OR held.seen < now() - make_interval(secs => :grace)"""
_RENEW = "UPDATE tunefree_claims SET seen = now() WHERE study = :study AND slot = :slot AND worker = :worker"
_RELEASE = "DELETE FROM tunefree_claims WHERE study = :study AND slot = :slot AND worker = :worker"


def worker_name() -> str:
    """Host, process and a random part: unique, and readable in the table."""
    return f"{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:6]}"


class SlotLeases:
    """The leases of one worker on the slots of one study."""

    def __init__(self, engine: sqlalchemy.Engine, study: str, *, grace_s: float = GRACE_S) -> None:
        self.engine = engine
        self.study = study
        self.grace_s = grace_s
        self.worker = worker_name()
        self._leased: set[int] = set()
        self._lock = threading.Lock()  # a renewal and the release of a slot exclude each other

    def create_table(self) -> None:
        """Make the table where there is none (the caller holds `server.advisory_lock`)."""
        with self.engine.begin() as connection:
            connection.execute(text(_TABLE))

    def acquire(self, slot: int) -> bool:
        """Lease `slot`; False where another worker has a valid lease."""
        is_acquired = self._execute(_ACQUIRE, slot, grace=self.grace_s) == 1
        if is_acquired:
            self._leased.add(slot)
        return is_acquired

    def renew(self, slot: int) -> None:
        """Renew the lease, unless it was released; acquires it again where the server has lost the row."""
        with self._lock:
            if slot in self._leased and self._execute(_RENEW, slot) == 0:
                self._execute(_ACQUIRE, slot, grace=self.grace_s)

    def release(self, slot: int) -> None:
        """Give the lease back."""
        with self._lock:
            self._leased.discard(slot)
            self._execute(_RELEASE, slot)

    def keep_renewed(self, slot: int) -> Heartbeat:
        """A context manager that renews the lease in the background."""
        return Heartbeat(self, slot)

    def _execute(self, statement: str, slot: int, **parameters: float) -> int:
        """The number of rows that the statement changed."""
        with self.engine.begin() as connection:
            values = {"study": self.study, "slot": slot, "worker": self.worker, **parameters}
            return connection.execute(text(statement), values).rowcount


class Heartbeat:
    """A thread that renews one lease. After a failed renewal, such as a lost connection, it tries again."""

    def __init__(self, leases: SlotLeases, slot: int) -> None:
        self.leases = leases
        self.slot = slot
        self.missed = 0  # failed renewals
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._renew_repeatedly, name=f"lease-{slot}", daemon=True)

    def __enter__(self) -> Heartbeat:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join()

    def _renew_repeatedly(self) -> None:
        while not self._end.wait(self.leases.grace_s / RENEWALS_PER_GRACE):
            try:
                self.leases.renew(self.slot)
            except SQLAlchemyError:
                self.missed += 1
