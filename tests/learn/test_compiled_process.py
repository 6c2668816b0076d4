"""The process beside ours: answers, progress, errors, and no orphan."""

from __future__ import annotations

import os
import signal
from collections.abc import Generator
from typing import Any

import pytest

from tunefree_hil.base.errors import InputError, PeerGone
from tunefree_hil.learn.compiled_process import CompiledProcess, make_request, run_request


def mode() -> tuple[str, int]:
    from tunefree_hil.base.kernel import MODE

    return MODE, os.getpid()


def counting(count: int) -> Generator[int, None, int]:
    total = 0
    for i in range(count):
        yield i
        total += i
    return total


def refusing() -> None:
    raise InputError("not this", code="not_this", key="some.key")


def wrong() -> float:
    return 1.0 / 0.0


def printing() -> str:
    print("noise on standard output")
    return "said"


def test_a_call_is_answered_once() -> None:
    assert [one.kind for one in run_request(make_request(counting, (2,)))] == ["progress", "progress", "result"]
    assert [one.kind for one in run_request(make_request(refusing, ()))] == ["error"]


def _drained(calling: Generator[Any, None, Any]) -> tuple[list[Any], Any]:
    seen = []
    while True:
        try:
            seen.append(next(calling))
        except StopIteration as end:
            return seen, end.value


@pytest.mark.slow
def test_the_process_compiles_kernels_and_serves_until_it_is_closed() -> None:
    with CompiledProcess() as worker:
        said, pid = worker.wait_for_result(mode)
        assert said == "1" and pid != os.getpid()
        assert _drained(worker.call(counting, 4)) == ([0, 1, 2, 3], 6)
        assert worker.wait_for_result(printing) == "said"
        with pytest.raises(InputError, match="not this") as caught:
            worker.wait_for_result(refusing)
        assert caught.value.key == "some.key"
        assert worker.wait_for_result(mode)[1] == pid, "a refusal does not end it"
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.slow
def test_a_mistake_ends_it_with_its_last_words() -> None:
    with CompiledProcess() as worker:
        with pytest.raises(PeerGone, match="ZeroDivisionError"):
            worker.wait_for_result(wrong)
        assert worker.wait_for_result(printing) == "said", "the next call has a new one"


@pytest.mark.slow
def test_a_process_that_is_killed_is_named() -> None:
    with CompiledProcess() as worker:
        pid = worker.wait_for_result(mode)[1]
        os.kill(pid, signal.SIGKILL)
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)  # gone, and still to be heard of by who started it
        with pytest.raises(PeerGone, match="-9"):
            worker.wait_for_result(mode)


@pytest.mark.slow
def test_a_call_that_nobody_hears_out_does_not_disturb_the_next() -> None:
    with CompiledProcess() as worker:
        calling = worker.call(counting, 100)
        assert next(calling) == 0
        calling.close()
        assert worker.wait_for_result(printing) == "said"


def test_one_that_was_ended_starts_no_process_any_more() -> None:
    """A thread that was about to ask would have one of its own, which nobody ends."""
    worker = CompiledProcess()
    worker.shut_down()
    with pytest.raises(PeerGone, match="was ended"):
        worker.wait_for_result(mode)
    assert worker._helper is None
