"""Chunks of a road sweep on the workers of a dask.distributed cluster.

Tasks and results are plain data; the function is one of this package, which every worker has installed. A chunk whose
worker is lost is driven by another one. When the scheduler is lost, the finished chunks are stored already.
"""

from __future__ import annotations

import contextlib
import logging
import re
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from types import ModuleType
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.jobs.robustness.driving.chunk import FinishedChunk, chunk_from_data
from tunefree_hil.jobs.robustness.driving.worker import drive_task, end_order, make_task_order
from tunefree_hil.jobs.robustness.plan import SweepPlan

SAME_COMMAND = "the same command goes on from the finished drives, with or without --scheduler"
ADDRESS = re.compile(r"(tcp|tls)://[^\s/:]+(\[.*\])?:\d+|(tcp|tls)://\[[^\s/]+\]:\d+")
LOGGERS = ("distributed", "distributed.client", "distributed.core", "distributed.comm")
INPUT_STATUS = InputError.exit_status


class ClusterCriteria(NamedTuple):
    """When a cluster is given up."""

    connect_s: float = 10.0  # s; a scheduler in one network answers in less than one
    worker_s: float = 60.0  # s without any worker; starting one takes a few
    fetch_s: float = 5.0  # s for the result of a finished chunk (75 kB); its worker may have gone meanwhile
    count_s: float = 1.0  # s between counts of the workers, each a question to the scheduler
    poll_s: float = 0.05  # s between looks; a chunk takes seconds
    max_attempts: int = 3  # of a chunk whose batch process ends; as dask's own limit for lost workers
    chunks_per_worker: int = 2  # in flight: one runs, one waits


CRITERIA = ClusterCriteria()


def require_address(address: str) -> None:
    """Raise InputError for what is no address of a scheduler."""
    if not ADDRESS.fullmatch(address):
        hint = "give it as tcp://HOST:PORT, as `dask scheduler` prints it"
        raise InputError(f"{address!r} is no address of a scheduler", code="usage", key="--scheduler", hint=hint)


def import_distributed() -> ModuleType:
    """The library. Raises InputError where it is not installed."""
    try:
        import distributed
    except ImportError as error:
        hint = "pip install '.[cluster]', or leave out --scheduler"
        raise InputError(
            "dask.distributed is not installed", code="no_distributed", key="--scheduler", hint=hint
        ) from error
    return distributed


def drive_on_cluster(plan: SweepPlan, numbers: Iterable[int], address: str) -> Iterator[FinishedChunk]:
    """Drive chunks on a cluster; they come in the order in which they are finished.

    Raises:
        InputError: No distributed, or a worker with other files or another version.
        BenchError: No scheduler, no worker, or the scheduler was lost.
    """
    distributed = import_distributed()
    for name in LOGGERS:  # a lost connection is reported by our own message
        logging.getLogger(name).setLevel(logging.CRITICAL)
    task = make_task_order(plan)
    try:
        client = distributed.Client(address, timeout=CRITERIA.connect_s, set_as_default=False)
    except (OSError, TimeoutError) as error:
        hint = "start one (`dask scheduler --host 127.0.0.1`), or leave out --scheduler"
        message = f"no scheduler answers at {address}"
        raise BenchError(message, code="no_scheduler", key="--scheduler", hint=hint) from error
    try:
        yield from _ClusterChunks(client, task, numbers).drive()
        if client.status == "running":
            client.run(end_order, plan.key, on_error="ignore")  # a worker that has just gone needs no end
    finally:
        with contextlib.suppress(OSError, TimeoutError, distributed.comm.CommClosedError):
            client.close(timeout=2.0)


class _ClusterChunks:
    """The chunks in flight, and those that wait."""

    def __init__(self, client: Any, task: Mapping[str, Any], numbers: Iterable[int]) -> None:
        self._client, self._task = client, task
        self._waiting = deque(numbers)
        self._in_flight: dict[Any, int] = {}
        self._attempts = Counter[int]()
        self._workers, self._counted_s = 0, -CRITERIA.count_s
        self._last_worker_s = time.monotonic()

    def drive(self) -> Iterator[FinishedChunk]:
        while self._waiting or self._in_flight:
            self._require_cluster()
            self._submit()
            for future in [future for future in self._in_flight if future.done()]:
                chunk = self._collect(future)
                if chunk is not None:
                    yield chunk
            time.sleep(CRITERIA.poll_s)

    def _require_cluster(self) -> None:
        """Raise BenchError where the scheduler is lost, or no worker has been there for a while."""
        if self._client.status != "running":
            raise BenchError(
                "the scheduler is lost",
                code="scheduler_lost",
                key="--scheduler",
                hint=f"start it again; {SAME_COMMAND}",
            )
        if time.monotonic() - self._counted_s > CRITERIA.count_s:
            self._workers = len(self._client.scheduler_info().get("workers", {}))
            self._counted_s = time.monotonic()
        if self._workers:
            self._last_worker_s = time.monotonic()
        elif time.monotonic() - self._last_worker_s > CRITERIA.worker_s:
            hint = f"start workers (`dask worker {self._client.scheduler.address} --nthreads 1`); {SAME_COMMAND}"
            raise BenchError("the scheduler has no worker", code="no_workers", key="--scheduler", hint=hint)

    def _submit(self) -> None:
        limit = CRITERIA.chunks_per_worker * max(self._workers, 1)
        while self._waiting and len(self._in_flight) < limit:
            number = self._waiting.popleft()
            # pure: a chunk that failed is to be driven anew, not answered from the scheduler's memory
            future = self._client.submit(drive_task, self._task, number, pure=False)
            self._in_flight[future] = number

    def _collect(self, future: Any) -> FinishedChunk | None:
        """The chunk of a future that is done; None where it has to be driven again, or its result is not yet here."""
        if self._client.status != "running":
            return None  # reported by the next look
        if future.status == "error":
            error = future.exception()
            message = f"a worker cannot drive: {type(error).__name__}: {error}"
            hint = f"look at its output; it needs tunefree_hil and its libraries. {SAME_COMMAND}"
            raise BenchError(message, code="worker_failed", key="--scheduler", hint=hint) from error
        if future.status != "finished":  # cancelled, as its scheduler was restarted
            self._waiting.appendleft(self._in_flight.pop(future))
            return None
        try:
            answer = future.result(timeout=CRITERIA.fetch_s)
        except (OSError, CancelledError):  # in time-outs and lost connections
            return None  # its worker or the scheduler is gone: the next look says which
        number = self._in_flight.pop(future)
        if "error" not in answer:
            return chunk_from_data(answer)
        self._note_error(number, answer["error"])
        return None

    def _note_error(self, number: int, error: Mapping[str, Any]) -> None:
        """Drive the chunk again after a lost process; raise any other error, and that of the last attempt."""
        self._attempts[number] += 1
        if error["status"] != INPUT_STATUS and self._attempts[number] < CRITERIA.max_attempts:
            self._waiting.appendleft(number)
            return
        kind = InputError if error["status"] == INPUT_STATUS else BenchError
        raise kind(
            error["message"],
            code=error["code"],
            file=error["file"],
            key=error["key"],
            hint=error["hint"] or SAME_COMMAND,
        )
