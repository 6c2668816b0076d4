"""The runner: who is there, what it says, how an episode ends, and every way in which one does not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.nodes.memory import FakeLink, FakeTime
from tunefree_hil.base.errors import BenchError, InputError, NoAnswer, PeerGone
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.tfhub.owner import HubStats
from tunefree_hil.grade.score import GRADED_ENDS
from tunefree_hil.nodes import runner as module
from tunefree_hil.nodes.runner import LEAD_MS, SILENT_LIMIT_S, Outcome, Runner

ECU, CONTROLLER, RUNNER = bc.Role.ECU, bc.Role.CONTROLLER, bc.Role.RUNNER
READY = [bc.Status(role, bc.State.READY, 0, 0) for role in (ECU, CONTROLLER)]


class FakeOwner:
    """A hub's owner that only notes what it is told."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.frames, self.more = 0, 0  # that have passed, and how many more at each look

    def stats(self) -> HubStats:
        self.frames += self.more
        return HubStats({"vehicle": self.frames, "bench": 1})

    def start_log(self, paths: Any) -> None:
        self.calls.append(f"start {sorted(paths)}")

    def stop_log(self) -> dict[str, int]:
        self.calls.append("stop")
        return {"vehicle": 7}


class Desk:
    """A runner on a link that answers what a test put into `answers`, one batch at each look."""

    def __init__(self, clock: FakeTime, *answers: list[Any], check: Callable[[], None] = lambda: None) -> None:
        self.clock = clock
        self.link = FakeLink(clock)
        self.link.later = [[bc.encode(message) for message in batch] for batch in answers]
        self.owner = FakeOwner()
        self.runner = Runner(self.link, self.owner, check)  # type: ignore[arg-type]

    def drive(self, **options: Any) -> Outcome:
        return self.runner.drive(b"abcdef" + bytes(26), 5, [0.25, 0.5], {"vehicle": Path("v.log")}, **options)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeTime:
    time = FakeTime()
    monkeypatch.setattr(module, "time", time)
    return time


def ended(state: bc.State, code: int, tick: int) -> bc.Status:
    return bc.Status(ECU, state, code, tick)


def test_meeting_waits_for_both(clock: FakeTime) -> None:
    ecu = bc.hello_messages(ECU, "mkz_nominal", [])
    controller = bc.hello_messages(CONTROLLER, "lqr", ["own.gain"])
    desk = Desk(clock, ecu[:1], controller, ecu[1:])
    desk.runner.meet()
    assert desk.runner.collector.name(ECU) == "mkz_nominal"
    assert desk.runner.collector.parameters(CONTROLLER) == {16: "own.gain"}
    assert [message.role for message in desk.link.words()] == [RUNNER] * len(desk.link.words())


@pytest.mark.parametrize(
    ("present", "missing"),
    [((), "ecu and controller"), ((ECU,), "controller"), ((CONTROLLER,), "ecu")],
)
def test_who_does_not_say_hello_is_named(clock: FakeTime, present: tuple[bc.Role, ...], missing: str) -> None:
    desk = Desk(clock, *[bc.hello_messages(role, "x", []) for role in present])
    with pytest.raises(NoAnswer, match=f"no hello from {missing} within 3 s") as caught:
        desk.runner.meet(3.0)
    assert "--session" in caught.value.hint
    assert ("INDEX NAME" in caught.value.hint) == (missing == "controller")


def test_half_a_hello_is_none_and_one_that_cannot_be_read_is_said_at_once(clock: FakeTime) -> None:
    ecu, own = bc.hello_messages(ECU, "mkz", []), bc.hello_messages(CONTROLLER, "own", ["own.gain"])
    with pytest.raises(NoAnswer, match=r"no hello from controller within 3 s; 2 of 4 parts of the controller's came"):
        Desk(clock, ecu, own[:2]).runner.meet(3.0)
    with pytest.raises(InputError, match=r"the controller's line '3 own\.gain' is not 'INDEX NAME'"):
        Desk(clock, ecu, bc.hello_messages(CONTROLLER, "own", {3: "own.gain"})).runner.meet(3.0)


def test_a_node_that_says_it_leaves_has_time_to_end_with_its_own_words(clock: FakeTime) -> None:
    started_s = clock.now_s

    def check() -> None:
        if clock.now_s > started_s + 1.0:
            raise PeerGone("ecu", "the ecu process ended with status 3; its last words: tick 20: no answer")

    desk = Desk(clock, READY, [bc.Status(ECU, bc.State.END, 0, 20)], check=check)
    with pytest.raises(PeerGone, match="last words: tick 20"):
        desk.drive()


def test_an_episode(clock: FakeTime) -> None:
    ticks = [[bc.Tick(k)] for k in range(3)]
    desk = Desk(clock, READY, *ticks, [ended(bc.State.FINISHED, 0, 3)])
    outcome = desk.drive()
    assert (outcome.ticks, outcome.error_code, outcome.error, outcome.logged) == (3, 0, "", {"vehicle": 7})
    assert outcome.wall_s > 0.0
    assert desk.owner.calls == ["start ['vehicle']", "stop"]
    assert desk.link.words() == [
        bc.Episode(b"abcdef", 5),
        bc.Param(0, 2, 0.25),
        bc.Param(1, 2, 0.5),
        bc.Status(RUNNER, bc.State.RUN, 0, LEAD_MS),
    ]


def test_the_controllers_reason_comes_before_the_ecus(clock: FakeTime) -> None:
    failed = bc.Status(CONTROLLER, bc.State.FAILED, int(bc.ErrorCode.LEFT_LANE), 9)
    desk = Desk(clock, READY, [failed], [ended(bc.State.FAILED, int(bc.ErrorCode.STOPPED), 10)])
    outcome = desk.drive()
    assert (outcome.ticks, outcome.error) == (10, "left_lane")


@pytest.mark.parametrize("apart", [False, True])
def test_a_failure_in_the_last_tick_counts_where_it_is_heard_after_the_end(clock: FakeTime, apart: bool) -> None:
    failed = bc.Status(CONTROLLER, bc.State.FAILED, int(bc.ErrorCode.LEFT_LANE), 10)
    end = ended(bc.State.FINISHED, 0, 10)
    desk = Desk(
        clock, READY, *([[end], [failed]] if apart else [[end, failed]]), READY, [ended(bc.State.FINISHED, 0, 3)]
    )
    assert desk.drive().error == "left_lane"
    assert desk.drive().ticks == 3, "and the next episode is not refused"


@pytest.mark.parametrize("number", [1000, 1001, 4711])
def test_a_controllers_own_error_has_one_name_and_keeps_its_number(clock: FakeTime, number: int) -> None:
    failed = [bc.Status(CONTROLLER, bc.State.FAILED, number, 9), ended(bc.State.FAILED, number, 10)]
    outcome = Desk(clock, READY, failed).drive()
    assert (outcome.error, outcome.error_code) == ("controller_own", number) and outcome.error in GRADED_ENDS
    with pytest.raises(BenchError, match=f"cannot load this episode: {bc.error_text(number)}") as caught:
        Desk(clock, failed[:1]).drive()
    assert caught.value.code == "controller_own"


@pytest.mark.parametrize("role", [ECU, CONTROLLER])
def test_a_node_that_cannot_load_is_named(clock: FakeTime, role: bc.Role) -> None:
    desk = Desk(clock, [bc.Status(role, bc.State.FAILED, int(bc.ErrorCode.UNKNOWN_SCENARIO), 0)])
    with pytest.raises(BenchError, match=f"the {role.name.lower()} cannot load this episode: unknown_scenario"):
        desk.drive()
    assert desk.owner.calls == [], "no log of a drive that did not begin"


@pytest.mark.parametrize(("there", "name"), [((), "controller and ecu"), (READY[:1], "controller")])
def test_a_node_that_does_not_load_is_named(clock: FakeTime, there: tuple[Any, ...], name: str) -> None:
    with pytest.raises(NoAnswer, match=f"^{name} did not load"):
        Desk(clock, list(there)).drive()


def test_silence_of_the_bench_ends_it_and_the_log_is_closed(clock: FakeTime) -> None:
    desk = Desk(clock, READY, [bc.Tick(0)])
    started_s = clock.now_s
    with pytest.raises(NoAnswer, match="no frame has passed for 7 s"):
        desk.drive()
    assert desk.owner.calls[-1] == "stop"
    assert SILENT_LIMIT_S <= clock.now_s - started_s <= SILENT_LIMIT_S + 3.0


def test_a_slow_drive_is_no_silence(clock: FakeTime) -> None:
    """Nothing for the runner itself in 60 s, but the hub's count moves."""
    desk = Desk(clock, READY, *[[] for _ in range(12000)], [ended(bc.State.FINISHED, 0, 9)])
    desk.owner.more = 1
    assert desk.drive().ticks == 9
    assert clock.now_s > 150.0


def test_a_node_that_leaves_in_the_drive_is_named(clock: FakeTime) -> None:
    desk = Desk(clock, READY, [bc.Status(ECU, bc.State.END, int(bc.ErrorCode.INTERNAL), 0)])
    with pytest.raises(PeerGone, match="the ecu has left the bench"):
        desk.drive()
    assert desk.owner.calls[-1] == "stop"


def test_a_dead_process_is_noticed_before_any_time_out(clock: FakeTime) -> None:
    def check() -> None:
        if clock.now_s > 101.0:
            raise PeerGone("ecu", "the ecu process was killed by signal 9")

    desk = Desk(clock, READY, check=check)
    with pytest.raises(PeerGone, match="signal 9"):
        desk.drive()
    assert clock.now_s < 102.0


def test_stop_and_end_are_said(clock: FakeTime) -> None:
    desk = Desk(clock)
    desk.runner.stop()
    desk.runner.end()
    assert [message.state for message in desk.link.words()] == [bc.State.STOP, bc.State.END]


def test_a_stopped_hub_is_named_and_not_asked_again(clock: FakeTime) -> None:
    ready = [bc.Status(role, bc.State.READY, 0, 0) for role in (ECU, CONTROLLER)]
    desk = Desk(clock, ready)

    def silent() -> HubStats:
        raise NoAnswer("the hub did not answer stats within 5 s")

    desk.owner.stats = silent  # type: ignore[method-assign]
    with pytest.raises(NoAnswer, match="the hub did not answer") as caught:
        desk.drive()
    assert isinstance(caught.value, module.HubSilent)
    assert "stop" not in desk.owner.calls


def test_parameters_of_the_list_and_announced_ones_are_sent_by_their_index(clock: FakeTime) -> None:
    hellos = [*bc.hello_messages(ECU, "mkz", []), *bc.hello_messages(CONTROLLER, "own", ["own.gain", "own.lag_s"])]
    desk = Desk(clock, hellos, READY, [ended(bc.State.FINISHED, 0, 3)])
    desk.runner.meet()
    assert desk.runner.announced() == {16: "own.gain", 17: "own.lag_s"}
    values = desk.runner.indexed({"own.lag_s": 0.5, "lqr.q1": 0.25, "own.gain": 2.0})
    assert values == {17: 0.5, 2: 0.25, 16: 2.0}
    with pytest.raises(InputError, match=r"the controller own has no parameter own\.gian") as caught:
        desk.runner.indexed({"own.gian": 1.0})
    assert "own.gain, own.lag_s" in caught.value.hint
    desk.runner.drive(b"abcdef" + bytes(26), 5, values, {})
    sent = [message for message in desk.link.words() if isinstance(message, bc.Param)]
    assert sent == [bc.Param(17, 3, 0.5), bc.Param(2, 3, 0.25), bc.Param(16, 3, 2.0)]
