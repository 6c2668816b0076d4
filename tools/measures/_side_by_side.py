"""Jobs side by side, one worker process a core: a bench in lockstep keeps about one core busy."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, TypeVar

J = TypeVar("J")
R = TypeVar("R")


def side_by_side(work: Callable[[J], R], jobs: Iterable[J], workers: int) -> Iterator[R]:
    """`work(job)` of every job, in the order in which they are done; with one worker in this process.

    `work` is a function of a module and jobs can be pickled. What a job raises ends the rest that has not begun.
    """
    todo = list(jobs)
    if workers <= 1 or len(todo) <= 1:
        yield from (work(job) for job in todo)
        return
    context = get_context("spawn")
    numbers = context.Queue()
    for number in range(workers):
        numbers.put(number)
    with ProcessPoolExecutor(workers, context, _pin, (numbers,)) as pool:
        try:
            for future in as_completed([pool.submit(work, job) for job in todo]):
                yield future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _pin(numbers: Any) -> None:
    """Keep this worker, and all that it will start, to a core of its own."""
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[numbers.get() % len(cores)]})
