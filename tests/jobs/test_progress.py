"""Steps told as progress: all of them, what they return, and an end of the steps when nobody listens any more."""

from __future__ import annotations

import time
from collections.abc import Generator

import pytest

from tests.jobs.ended import ended
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.gap.progress import SearchProgress, SearchStage
from tunefree_hil.jobs.progress import left_s, progress_data, relay_events


def counted(most: int, closed: list[bool], fails: bool = False) -> Generator[int, None, str]:
    try:
        yield from range(most)
        if fails:
            raise InputError("no more")
    finally:
        closed.append(True)
    return "done"


def as_event(step: int) -> Event:
    return Event("progress", f"step {step}")


def test_every_step_is_told_and_the_result_returned() -> None:
    found, said = ended(relay_events(counted(3, []), as_event))
    assert found == "done" and [event.message for event in said] == ["step 0", "step 1", "step 2"]


def test_steps_end_at_once_when_nobody_listens_any_more() -> None:
    closed: list[bool] = []
    steps = counted(3, closed)  # held here, so that no tidying of memory ends it
    listening = relay_events(steps, as_event)
    next(listening)
    listening.close()
    assert closed == [True] and list(steps) == []


def test_an_error_of_a_step_comes_through() -> None:
    with pytest.raises(InputError, match="no more"):
        ended(relay_events(counted(1, [], fails=True), as_event))


def test_what_is_left_goes_by_the_share_that_is_done() -> None:
    began = time.monotonic() - 10.0
    assert left_s(began, 0.0) is None and left_s(began, 1.0) == 0.0
    assert (left_s(began, 0.25) or 0.0) > 29.9  # and more the longer this takes to be asked


def test_a_search_says_what_is_left_only_where_some_of_it_has_gone() -> None:
    began = time.monotonic() - 10.0
    assert progress_data(SearchProgress(SearchStage.RECALIBRATION, "every link by itself"), began) == {}
    found = progress_data(SearchProgress(SearchStage.CANDIDATES, "42 candidates"), began)
    assert (found["done"], found["total"]) == (24, 100) and found["eta_s"] > 10.0
