"""Who works on which slot of a shared study: one row a slot, taken and kept alive by the server's own clock.

A claim is an INSERT that only one of two workers can make; its worker touches the row every few seconds. One that has
not been touched for `grace_s` belongs to a worker that is gone, and anybody may take it over.
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
BEATS = 5  # in a time of grace

_TABLE = """CREATE TABLE IF NOT EXISTS tunefree_claims (
    study text NOT NULL, slot integer NOT NULL, worker text NOT NULL, seen timestamptz NOT NULL,
    PRIMARY KEY (study, slot))"""
_TAKE = """INSERT INTO tunefree_claims AS held (study, slot, worker, seen) VALUES (:study, :slot, :worker, now())
    ON CONFLICT (study, slot) DO UPDATE SET worker = excluded.worker, seen = now()
    WHERE held.worker = excluded.worker OR held.seen < now() - make_interval(secs => :grace)"""
_TOUCH = "UPDATE tunefree_claims SET seen = now() WHERE study = :study AND slot = :slot AND worker = :worker"
_LEAVE = "DELETE FROM tunefree_claims WHERE study = :study AND slot = :slot AND worker = :worker"


def worker_name() -> str:
    """Host, process and a random part: unique, and readable where somebody looks into the table."""
    return f"{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:6]}"


class Claims:
    """The claims of one worker on the slots of one study."""

    def __init__(self, engine: sqlalchemy.Engine, study: str, *, grace_s: float = GRACE_S) -> None:
        self.engine = engine
        self.study = study
        self.grace_s = grace_s
        self.worker = worker_name()
        self._held: set[int] = set()
        self._lock = threading.Lock()  # between the beats of a slot and its return

    def create(self) -> None:
        """Make the table where it is not there (the caller holds `server.one_at_a_time`)."""
        with self.engine.begin() as connection:
            connection.execute(text(_TABLE))

    def take(self, slot: int) -> bool:
        """Claim `slot`; False where a living worker has it."""
        taken = self._run(_TAKE, slot, grace=self.grace_s) == 1
        if taken:
            self._held.add(slot)
        return taken

    def touch(self, slot: int) -> None:
        """Say that we live; nothing for a slot that was given back. Takes it again where a server lost the row."""
        with self._lock:
            if slot in self._held and self._run(_TOUCH, slot) == 0:
                self._run(_TAKE, slot, grace=self.grace_s)

    def leave(self, slot: int) -> None:
        """Give `slot` back."""
        with self._lock:
            self._held.discard(slot)
            self._run(_LEAVE, slot)

    def alive(self, slot: int) -> Pulse:
        """Touch the claim in the background as long as the `with` lasts."""
        return Pulse(self, slot)

    def _run(self, statement: str, slot: int, **more: float) -> int:
        with self.engine.begin() as connection:
            values = {"study": self.study, "slot": slot, "worker": self.worker, **more}
            return connection.execute(text(statement), values).rowcount


class Pulse:
    """A thread that touches one claim. A server that is gone for a while is no reason to stop: the next beat counts."""

    def __init__(self, claims: Claims, slot: int) -> None:
        self.claims = claims
        self.slot = slot
        self.missed = 0  # beats that did not reach the server
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._beat, name=f"claim-{slot}", daemon=True)

    def __enter__(self) -> Pulse:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join()

    def _beat(self) -> None:
        while not self._end.wait(self.claims.grace_s / BEATS):
            try:
                self.claims.touch(self.slot)
            except SQLAlchemyError:
                self.missed += 1
