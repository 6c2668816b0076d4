"""Messages whole or not at all; a helper answers, is named where it is lost, and outlives nobody."""

from __future__ import annotations

import io
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.base import pipes
from tunefree_hil.base.errors import PeerGone
from tunefree_hil.base.pipes import LAST_LINES, Helper, Loss, receive, send

LOSS = Loss("echo", "the process that echoes", "echo_lost", "shout again")
SOON_S = 10.0

MESSAGES = st.recursive(
    st.none() | st.integers() | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.tuples(inner, inner) | st.dictionaries(st.text(), inner),
    max_leaves=4,
)


class Dripping:
    """A pipe that gives at most `most` bytes at once, as a real one may."""

    def __init__(self, data: bytes, most: int) -> None:
        self._data = io.BytesIO(data)
        self._most = most

    def read(self, size: int) -> bytes:
        return self._data.read(min(size, self._most))


def written(*messages: Any) -> bytes:
    pipe = io.BytesIO()
    for message in messages:
        send(pipe, message)
    return pipe.getvalue()


@settings(max_examples=25)
@given(st.lists(MESSAGES, min_size=1, max_size=3), st.integers(1, 9))
def test_messages_come_as_they_went_however_they_drip(messages: list[Any], most: int) -> None:
    pipe = cast(BinaryIO, Dripping(written(*messages), most))
    assert [receive(pipe) for _ in messages] == messages
    with pytest.raises(EOFError):
        receive(pipe)


@given(MESSAGES, st.data())
def test_a_message_that_is_cut_is_none(message: Any, data: st.DataObject) -> None:
    whole = written(message)
    cut = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(EOFError):
        receive(io.BytesIO(whole[:cut]))


@pytest.fixture
def helper(repo: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Helper]:
    monkeypatch.chdir(repo)
    monkeypatch.setenv("HEARD_FROM_US", "yes")
    monkeypatch.setenv("OURS", "ours")
    one = Helper("tests.base.pipes_helper", {"OURS": "its own"}, LOSS)
    try:
        yield one
    finally:
        one.close()


@pytest.mark.slow
def test_it_has_our_environment_and_its_own_and_may_print(helper: Helper) -> None:
    assert helper.ask(("variable", "HEARD_FROM_US")) == "yes"
    assert helper.ask(("variable", "OURS")) == "its own" and os.environ["OURS"] == "ours"
    assert helper.ask(("print", "noise")) == "noise"
    helper.send_request(("count", 3))
    assert [helper.receive_answer() for _ in range(3)] == [0, 1, 2]


@pytest.mark.slow
def test_one_that_ends_is_named_with_its_last_words(helper: Helper) -> None:
    lines = [f"line {number}" for number in range(LAST_LINES + 5)]
    with pytest.raises(PeerGone) as caught:
        helper.ask(("end", "\n".join(lines)))
    said = str(caught.value)
    assert "the process that echoes has ended (3)\n    line 5\n" in said and "line 4\n" not in said
    assert said.count("line ") == LAST_LINES
    assert (caught.value.code, caught.value.hint) == ("echo_lost", "shout again")
    with pytest.raises(PeerGone, match="3"):
        helper.ask(("print", "once more"))


class Unreadable:
    """A message that its reader cannot make: as that of another version of the program is."""

    def __reduce__(self) -> tuple[type[int], tuple[str]]:
        return int, ("no number",)


@pytest.mark.slow
@pytest.mark.timeout(30)
def test_a_request_that_cannot_be_read_ends_it_with_the_reason(helper: Helper) -> None:
    helper.send_request(("echo", Unreadable()))
    with pytest.raises(PeerGone, match="invalid literal for int"):
        helper.receive_answer()


@pytest.mark.slow
def test_one_that_is_killed_is_named_by_the_signal(helper: Helper) -> None:
    helper.process.kill()
    helper.process.wait(SOON_S)
    with pytest.raises(PeerGone, match=r"has ended \(-9\)"):
        helper.send_request(("print", "x"))
    with pytest.raises(PeerGone, match=r"has ended \(-9\)"):
        helper.receive_answer()


@pytest.mark.slow
@pytest.mark.parametrize("half", ["send", "receive"])
def test_an_interrupted_message_is_not_gone_on_with(helper: Helper, half: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(pipes, half, interrupted)
        helper.ask(("print", "x"))
    with pytest.raises(PeerGone, match=r"\(-9\)"):
        helper.ask(("print", "y"))


@pytest.mark.slow
def test_it_ends_when_it_is_closed_and_is_closed_twice_in_peace(helper: Helper) -> None:
    helper.send_request(("sleep", 60.0))
    helper.close()
    assert helper.process.returncode == -signal.SIGKILL
    helper.close()


@pytest.mark.slow
def test_it_ends_in_the_middle_of_its_work_when_its_starter_is_gone(helper: Helper) -> None:
    assert helper.ask(("print", "awake")) == "awake"
    helper.send_request(("sleep", 60.0))
    cast(BinaryIO, helper.process.stdin).close()
    assert helper.process.wait(SOON_S) == 0
