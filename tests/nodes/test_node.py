"""What ECU and controller share: hello, load when all parameters are there, run, end; a mistake is said on the bus."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.nodes.memory import FakeLink
from tunefree_hil.base.clock import Clock, RealClock
from tunefree_hil.base.errors import InputError, PeerGone
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.link import separate_links
from tunefree_hil.nodes.exchange import Exchange
from tunefree_hil.nodes.node import Announcement, Node

RUNNER = bc.Role.RUNNER
END = bc.Status(RUNNER, bc.State.END, 0, 0)
RUN = bc.Status(RUNNER, bc.State.RUN, 0, 200)
EPISODE = bc.Episode(b"abcdef", 9)
NAMED = Announcement("name", ["own.gain"])


class NotedPart:
    """A part that only notes what it is asked to do."""

    role = bc.Role.CONTROLLER

    def __init__(self, trouble: Exception | None = None) -> None:
        self.trouble = trouble
        self.calls: list[Any] = []

    def load(self, scenario: bytes, seed: int, parameters: dict[int, float]) -> None:
        self.calls.append(("load", scenario, seed, parameters))
        if self.trouble is not None:
            raise self.trouble

    def lockstep(self, exchange: Exchange, stopped: Callable[[Any], bool]) -> None:
        self.calls.append("lockstep")

    def realtime(self, exchange: Exchange, clock: Clock, zero_s: float, stopped: Callable[[Any], bool]) -> None:
        self.calls.append(("realtime", zero_s))


def serve(part: NotedPart, *messages: Any, realtime: bool = False, stamp_s: float = 0.0) -> list[Any]:
    """The bench messages that a node sends when it hears these; END follows."""
    bench = FakeLink()
    bench.say(*messages, END, time_s=stamp_s)
    exchange = Exchange(separate_links(FakeLink(), bench), (frozenset(), frozenset()), 0.01)
    Node(part, exchange, NAMED, RealClock(), realtime).serve()
    return bench.words()


HELLO = bc.hello_messages(bc.Role.CONTROLLER, "name", ["own.gain"])
READY = bc.Status(bc.Role.CONTROLLER, bc.State.READY, 0, 0)


def test_hello_first_and_again_when_a_runner_comes() -> None:
    assert serve(NotedPart()) == HELLO
    assert serve(NotedPart(), *bc.hello_messages(RUNNER, "a runner", [])) == HELLO * 2
    assert serve(NotedPart(), *bc.hello_messages(bc.Role.ECU, "an ecu", [])) == HELLO


def test_it_loads_when_all_parameters_are_there() -> None:
    part = NotedPart()
    said = serve(part, EPISODE, bc.Param(1, 2, 0.5), bc.Param(0, 2, 0.25))
    assert part.calls == [("load", b"abcdef", 9, {0: 0.25, 1: 0.5})]
    assert said == [*HELLO, READY]


def test_it_does_not_load_with_a_parameter_missing() -> None:
    part = NotedPart()
    assert serve(part, EPISODE, bc.Param(0, 2, 0.25)) == HELLO
    assert part.calls == []


def test_parameters_of_an_earlier_episode_do_not_count() -> None:
    part = NotedPart()
    serve(part, EPISODE, bc.Param(0, 2, 0.25), bc.Episode(b"ghijkl", 1), bc.Param(1, 2, 0.5))
    assert part.calls == []


def test_run_runs_once() -> None:
    part = NotedPart()
    serve(part, RUN, EPISODE, bc.Param(0, 1, 0.25), RUN, RUN)
    assert part.calls[1:] == ["lockstep"]


def test_real_time_begins_a_lead_after_run() -> None:
    part = NotedPart()
    serve(part, EPISODE, bc.Param(0, 1, 0.25), RUN, realtime=True, stamp_s=12.0)
    assert part.calls[1:] == [("realtime", pytest.approx(12.2))]


@pytest.mark.parametrize(
    ("code", "said"),
    [("unknown_scenario", bc.ErrorCode.UNKNOWN_SCENARIO), ("bad_parameters", bc.ErrorCode.CONTROL_ERROR)],
)
def test_an_episode_that_cannot_be_loaded_is_said_and_raised(code: str, said: bc.ErrorCode) -> None:
    part = NotedPart(InputError("no scenario file has it", code=code))
    bench = FakeLink()
    bench.say(EPISODE, bc.Param(0, 1, 0.25))
    node = Node(part, Exchange(separate_links(FakeLink(), bench), (frozenset(), frozenset()), 0.01), NAMED, RealClock())
    with pytest.raises(InputError):
        node.serve()
    words = bench.words()[len(HELLO) :]
    assert words[0] == bc.Status(bc.Role.CONTROLLER, bc.State.FAILED, said, 0)
    assert words[-1].state == bc.State.END, "the others need not wait for it"


def test_a_bus_that_is_gone_is_the_error_whatever_cannot_be_said_then() -> None:
    bench = FakeLink()
    bench.trouble = PeerGone("hub")
    node = Node(
        NotedPart(), Exchange(separate_links(FakeLink(), bench), (frozenset(), frozenset()), 0.01), NAMED, RealClock()
    )
    with pytest.raises(PeerGone, match="hub is gone"):
        node.serve()


@pytest.mark.parametrize(
    ("message", "ends"),
    [
        (bc.Status(RUNNER, bc.State.STOP, 0, 0), True),
        (END, True),
        (bc.Status(bc.Role.ECU, bc.State.FINISHED, 0, 100), True),
        (bc.Status(bc.Role.ECU, bc.State.FAILED, 2, 100), True),
        (bc.Status(bc.Role.ECU, bc.State.READY, 0, 0), False),
        (bc.Status(bc.Role.CONTROLLER, bc.State.FAILED, 2, 100), False),
        (RUN, False),
        (bc.Tick(3), False),
    ],
)
def test_what_ends_a_running_episode(message: Any, ends: bool) -> None:
    assert Node._stopped(message) is ends
