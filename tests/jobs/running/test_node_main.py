"""What stands in the controller's place says who it is, and ends when it is told to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.bench.own_part import write_own
from tests.bench.tiny import hash_of, write_bench
from tunefree_hil.base.clock import RealClock
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import ControllerFor, load, parameters_of
from tunefree_hil.bus.bench_channel import ErrorCode, HelloCollector, Role, State, Status
from tunefree_hil.jobs.collector import PlannerAssigner, collector
from tunefree_hil.jobs.controller import controller
from tunefree_hil.jobs.options.nodes import NodeLink
from tunefree_hil.jobs.running import node_main
from tunefree_hil.nodes.controller import ControllerPart

LINK = NodeLink("tfhub", session="nobody")
END = Status(Role.RUNNER, State.END, ErrorCode.NONE, 0)


class FakeExchange:
    """An exchange on which the runner says end at once, and what was said on it."""

    def __init__(self) -> None:
        self.said: list[Any] = []

    def send_messages(self, message: Any) -> None:
        self.said.append(message)

    def next_message(self, timeout_s: float) -> Status:
        return END


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """(exchange, the name it was opened by, bus, bench bus, session, realtime) of each node that serves."""
    found: list[tuple[Any, ...]] = []

    @contextmanager
    def open_exchange(bench: Any, name: str, link: NodeLink) -> Iterator[Any]:
        exchange = FakeExchange()
        found.append((exchange, name, *link))
        yield exchange, RealClock(), "a wire of this test"

    monkeypatch.setattr(node_main, "open_exchange", open_exchange)
    return found


@pytest.mark.parametrize(
    ("job", "command", "name"), [(controller, "controller", "lqr_pid_mrac"), (collector, "collector", "collector")]
)
def test_it_says_who_it_is_and_ends_when_told(
    job: Callable[..., Iterator[Event]], command: str, name: str, opened: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    note, result = job(write_bench(tmp_path), LINK)
    ((exchange, *asked),) = opened
    assert asked == ["controller", "tfhub", "", "nobody", False]
    heard = HelloCollector()
    for message in exchange.said:
        heard.add(message)
    assert heard.name(Role.CONTROLLER) == name
    assert (note.kind, note.message) == ("note", f"{command}: mkz_bywire on a wire of this test")
    assert result.kind == "result" and result.data == {"sentence": f"{command}: ended by the runner", "next": []}


def test_the_controller_announces_what_its_parts_bring(opened: list[tuple[Any, ...]], tmp_path: Path) -> None:
    list(controller(write_own(tmp_path), LINK))
    heard = HelloCollector()
    for message in opened[0][0].said:
        heard.add(message)
    assert heard.parameters(Role.CONTROLLER) == {16: "mine.gain"}


def test_each_has_what_drives_it(
    opened: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The controller follows a scenario; the collector refuses one without a plan beside it."""
    parts: list[ControllerPart] = []

    def kept(part: ControllerPart, *_: object) -> Any:
        parts.append(part)
        return type("Node", (), {"serve": lambda self: None})()

    monkeypatch.setattr(node_main, "Node", kept)
    bench = write_bench(tmp_path)
    for job in (controller, collector):
        list(job(bench, LINK))
    follows, collects = parts
    values = parameters_of(load(bench))
    assert isinstance(follows.assign, ControllerFor)
    assert follows.assign(hash_of(tmp_path), follows.assign.indexed(values)).ticks == 200
    assert isinstance(collects.assign, PlannerAssigner)
    with pytest.raises(InputError, match="cannot read the plan of a drive"):
        collects.assign(hash_of(tmp_path), {})
