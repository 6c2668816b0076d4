"""Phases: they end with DONE and all frames, whatever the order of arrival; who does not answer is named."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import pytest

from tests.nodes.memory import FakeLink, FakeTime
from tunefree_hil.base.errors import BenchError, NoAnswer, PeerGone
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.dbc.message_map import EXTENDED_FLAG
from tunefree_hil.bus.link import separate_links
from tunefree_hil.nodes import exchange as module
from tunefree_hil.nodes.exchange import HARD_LIMIT_S, Exchange, can_key, digest

REPORTS = frozenset({0x61, 0x63, 0x100 | EXTENDED_FLAG})
COMMANDS = frozenset({0x60, 0x62})
FRAMES = [CanFrame(0x61, b"a"), CanFrame(0x61, b"b"), CanFrame(0x63, b"c"), CanFrame(0x100, b"d", True)]


def never(message: Any) -> bool:
    return False


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeTime:
    time = FakeTime()
    monkeypatch.setattr(module, "time", time)
    return time


def exchange_of(clock: FakeTime | None = None) -> tuple[Exchange, FakeLink, FakeLink]:
    clock = clock or FakeTime()
    vehicle, bench = FakeLink(clock), FakeLink(clock)
    return Exchange(separate_links(vehicle, bench), (REPORTS, COMMANDS), 0.01), vehicle, bench


def done_of(k: int, phase: int, frames: list[CanFrame]) -> bc.Done:
    return bc.Done(k, phase, len(frames), digest(sorted(frames, key=can_key)))


def test_an_extended_id_is_another_id() -> None:
    assert can_key(CanFrame(0x61, b"")) == 0x61
    assert can_key(CanFrame(0x61, b"", True)) == 0x61 | EXTENDED_FLAG
    exchange, vehicle, bench = exchange_of()
    vehicle.arrive(CanFrame(0x100, b"x"), CanFrame(0x100, b"y", True), CanFrame(0x61, b"z", True))
    bench.say(done_of(0, 0, [CanFrame(0x100, b"y", True)]))
    assert exchange.await_phase(0, 0, never) == [CanFrame(0x100, b"y", True)]


def test_a_long_id_comes_after_every_short_one() -> None:
    ids = frozenset({0x61, 0x60 | EXTENDED_FLAG})
    exchange = Exchange(separate_links(vehicle := FakeLink(), FakeLink()), (ids, COMMANDS), 0.01)
    exchange.announce(0, 0, [CanFrame(0x60, b"long", True), CanFrame(0x61, b"short")])
    assert [frame.id for frame in vehicle.frames()] == [0x61, 0x60]


def test_what_is_prepared_waits_for_its_call() -> None:
    exchange, vehicle, bench = exchange_of()
    send = exchange.prepare(8, 0, [FRAMES[2], FRAMES[0]], bc.Tick(8))
    assert vehicle.sent == bench.sent == []
    send()
    assert vehicle.sent == [[FRAMES[0], FRAMES[2]]]
    assert bench.words() == [bc.Tick(8), done_of(8, 0, [FRAMES[0], FRAMES[2]])]


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_without_long_ids_the_order_is_the_same(order: tuple[int, ...]) -> None:
    vehicle, bench = FakeLink(), FakeLink()
    exchange = Exchange(separate_links(vehicle, bench), (frozenset({0x61, 0x63}), COMMANDS), 0.01)
    frames = [FRAMES[i] for i in order]
    vehicle.arrive(*frames, CanFrame(0x63, b"long", True))
    bench.say(done_of(0, 0, frames))
    assert exchange.await_phase(0, 0, never) == sorted(frames, key=can_key)


@pytest.mark.parametrize("order", list(permutations(range(4))))
def test_frames_come_in_id_and_sequence_order(order: tuple[int, ...]) -> None:
    """Any order of ids gives the same hand-over; two frames of one id keep theirs."""
    frames = [FRAMES[i] for i in order]
    first, second = (frame for frame in frames if frame.id == 0x61)
    exchange, vehicle, bench = exchange_of()
    vehicle.arrive(*frames)
    bench.say(done_of(3, 0, frames))
    assert exchange.await_phase(3, 0, never) == [first, second, FRAMES[2], FRAMES[3]]


def test_a_phase_waits_for_done_and_for_every_frame(clock: FakeTime) -> None:
    exchange, vehicle, bench = exchange_of(clock)
    vehicle.arrive(FRAMES[0])
    vehicle.later = [[FRAMES[1]], [], [FRAMES[2]]]
    bench.later = [[], [bc.encode(done_of(0, 0, FRAMES[:3]))]]
    started_s = clock.now_s
    assert exchange.await_phase(0, 0, never) == FRAMES[:3]
    assert clock.now_s - started_s == pytest.approx(2 * module.SLICE_S + 3 * module.SLICE_S)


def test_done_without_frames_ends_a_phase() -> None:
    exchange, _, bench = exchange_of()
    bench.say(bc.Done(5, 1, 0, 0))
    assert exchange.await_phase(5, 1, never) == []


def test_done_of_another_tick_or_phase_does_not_count(clock: FakeTime) -> None:
    exchange, _, bench = exchange_of(clock)
    bench.say(bc.Done(4, 1, 0, 0), bc.Done(5, 0, 0, 0))
    with pytest.raises(NoAnswer):
        exchange.await_phase(5, 1, never)


def test_each_phase_keeps_its_own_frames() -> None:
    exchange, vehicle, bench = exchange_of()
    command = CanFrame(0x60, b"go")
    vehicle.arrive(command, FRAMES[0])
    bench.say(done_of(0, 0, [FRAMES[0]]), done_of(0, 1, [command]))
    assert exchange.await_phase(0, 0, never) == [FRAMES[0]]
    assert exchange.await_phase(0, 1, never) == [command]


@pytest.mark.parametrize("changed", [CanFrame(0x61, b"B"), CanFrame(0x63, b"b")])
def test_other_frames_than_announced_are_refused(changed: CanFrame) -> None:
    exchange, vehicle, bench = exchange_of()
    vehicle.arrive(FRAMES[0], changed)
    bench.say(done_of(7, 0, FRAMES[:2]))
    with pytest.raises(BenchError, match="tick 7: the 2 frames of the ecu are not those it announced") as caught:
        exchange.await_phase(7, 0, never)
    assert caught.value.code == "digest" and "--session" in caught.value.hint


def test_a_surplus_frame_is_refused() -> None:
    """A second controller on the bus: its frames are of the same ids."""
    exchange, vehicle, bench = exchange_of()
    vehicle.arrive(CanFrame(0x60, b"mine"), CanFrame(0x60, b"other"))
    bench.say(done_of(0, 1, [CanFrame(0x60, b"mine")]))
    with pytest.raises(BenchError) as caught:
        exchange.await_phase(0, 1, never)
    assert caught.value.code == "digest"


def test_foreign_frames_are_not_handed_over() -> None:
    exchange, vehicle, bench = exchange_of()
    vehicle.arrive(CanFrame(0x7FF, b"?"), FRAMES[0], CanFrame(0x7FF, b"?"))
    bench.say(done_of(0, 0, FRAMES[:1]))
    assert exchange.await_phase(0, 0, never) == FRAMES[:1]


@pytest.mark.parametrize(("phase", "name"), [(0, "ecu"), (1, "controller")])
def test_silence_is_named_at_the_hard_limit(phase: int, name: str, clock: FakeTime) -> None:
    exchange, _, _ = exchange_of(clock)
    started_s = clock.now_s
    with pytest.raises(NoAnswer, match=f"tick 9: the {name} did not answer within 5 s") as caught:
        exchange.await_phase(9, phase, never)
    assert name in caught.value.hint
    assert HARD_LIMIT_S <= clock.now_s - started_s <= HARD_LIMIT_S + 2 * module.SLICE_S


def test_announced_frames_that_never_come_are_named(clock: FakeTime) -> None:
    exchange, vehicle, bench = exchange_of(clock)
    vehicle.arrive(FRAMES[0])
    bench.say(done_of(2, 0, FRAMES[:3]))
    with pytest.raises(NoAnswer, match=r"tick 2: the ecu announced 3 frames, 1 arrived \(0x61\)") as caught:
        exchange.await_phase(2, 0, never)
    assert caught.value.code == "frames_missing"


def test_an_interrupt_ends_the_wait_and_keeps_what_came_after_it() -> None:
    exchange, _, bench = exchange_of()
    stop, after = bc.Status(bc.Role.RUNNER, bc.State.STOP, 0, 0), bc.Episode(b"abcdef", 3)
    bench.say(bc.Tick(1), stop, after)
    seen = []

    def interrupt(message: Any) -> bool:
        seen.append(message)
        return message == stop

    assert exchange.await_phase(0, 1, interrupt) is None
    assert seen == [bc.Tick(1), stop]
    assert exchange.inbox == [after]


def test_in_real_time_too_what_came_after_an_interrupt_is_kept() -> None:
    exchange, _, bench = exchange_of()
    stop, after = bc.Status(bc.Role.ECU, bc.State.FINISHED, 0, 9), bc.Episode(b"abcdef", 3)
    bench.say(bc.Tick(8), bc.Done(8, 0, 0, 0))
    assert not exchange.interrupted(lambda message: message == stop)
    assert exchange.inbox == [], "what ends nothing has been looked at"
    bench.say(bc.Tick(9), stop, after)
    assert exchange.interrupted(lambda message: message == stop)
    assert exchange.inbox == [after]


def test_what_follows_done_is_left_for_the_next_look() -> None:
    exchange, _, bench = exchange_of()
    ended = bc.Status(bc.Role.ECU, bc.State.FINISHED, 0, 1)
    bench.say(bc.Done(0, 1, 0, 0), ended)
    assert exchange.await_phase(0, 1, lambda message: message == ended) == []
    assert exchange.inbox == [ended]


def test_a_node_that_leaves_is_named_at_once(clock: FakeTime) -> None:
    exchange, _, bench = exchange_of(clock)
    bench.say(bc.Status(bc.Role.CONTROLLER, bc.State.END, int(bc.ErrorCode.INTERNAL), 0))
    started_s = clock.now_s
    with pytest.raises(PeerGone, match="tick 4: the controller has left the bench") as caught:
        exchange.await_phase(4, 1, never)
    assert caught.value.peer == "controller" and clock.now_s == started_s


def test_messages_one_by_one() -> None:
    exchange, _, bench = exchange_of()
    messages = [bc.Episode(b"abcdef", 3), bc.Param(0, 1, 0.5)]
    bench.arrive(CanFrame(0x123, b"noise"))
    bench.say(*messages)
    assert [exchange.next_message(0.1) for _ in range(3)] == [*messages, None]


def test_run_has_the_stamp_at_which_it_passed_the_bus() -> None:
    exchange, _, bench = exchange_of()
    bench.say(bc.Status(bc.Role.RUNNER, bc.State.RUN, 0, 200), time_s=12.5)
    exchange.next_message(0.0)
    assert exchange.run_stamp_s == 12.5


def test_announcing_sends_frames_first_then_words_then_done() -> None:
    exchange, vehicle, bench = exchange_of()
    failed = bc.Status(bc.Role.CONTROLLER, bc.State.FAILED, 2, 8)
    exchange.announce(8, 1, [FRAMES[2], FRAMES[0], FRAMES[1]], failed)
    assert vehicle.sent == [[FRAMES[0], FRAMES[1], FRAMES[2]]]
    assert bench.words() == [failed, done_of(8, 1, FRAMES[:3])]
    assert {frame.time_s for frame in bench.frames()} == {0.08}


def test_nothing_to_send_is_no_empty_write() -> None:
    exchange, vehicle, bench = exchange_of()
    exchange.announce(0, 1, [])
    assert vehicle.sent == [] and bench.words() == [bc.Done(0, 1, 0, 0)]


def test_real_time_takes_what_was_stamped_before_the_deadline() -> None:
    exchange, vehicle, _ = exchange_of()
    early, late = FRAMES[0]._replace(time_s=1.0), FRAMES[1]._replace(time_s=2.0)
    vehicle.arrive(late, early, CanFrame(0x60, b"", time_s=0.5))
    assert exchange.take_before(0, 2.0) == [early]
    assert exchange.take_before(0, 2.0) == []
    assert exchange.take_before(0, 2.5) == [late]


def test_clearing_forgets_an_ended_episode() -> None:
    exchange, vehicle, bench = exchange_of()
    vehicle.arrive(FRAMES[0], CanFrame(0x60, b"old"))
    exchange.clear()
    bench.say(bc.Done(0, 0, 0, 0), bc.Done(0, 1, 0, 0))
    assert exchange.await_phase(0, 0, never) == [] and exchange.await_phase(0, 1, never) == []


def test_the_digest_tells_changed_payloads_apart() -> None:
    """16 bits miss about one change in 65536: of all 2040 changes of one byte at most a few, of all orders none."""
    payload = bytes(range(8))
    first = digest([CanFrame(0x61, payload)])
    changes = [bytes([*payload[:i], payload[i] ^ x, *payload[i + 1 :]]) for i in range(8) for x in range(1, 256)]
    missed = [data for data in changes if digest([CanFrame(0x61, data)]) == first]
    assert len(missed) <= 3
    assert len({digest(list(order)) for order in permutations(FRAMES)}) == 24


def test_only_what_a_full_queue_took_is_announced() -> None:
    """Real time on SocketCAN: a frame that was dropped must not look lost, or a foreign one."""
    exchange, vehicle, bench = exchange_of()
    exchange = Exchange(separate_links(vehicle, bench), (REPORTS, COMMANDS), 0.01, drops=True)
    vehicle.refused = (FRAMES[3],)
    exchange.announce(4, 0, list(FRAMES))
    assert bench.words() == [done_of(4, 0, FRAMES[:3])]
    assert exchange.refused == 1
    vehicle.refused = ()
    exchange.announce(5, 0, list(FRAMES), bc.Tick(5))
    assert bench.words()[1:] == [bc.Tick(5), done_of(5, 0, FRAMES)]


def test_frames_lost_between_episodes_are_nobodys() -> None:
    exchange, vehicle, _ = exchange_of()
    vehicle.trouble = BenchError("3 frames did not fit", code="rx_overflow")
    exchange.clear()
    vehicle.trouble = BenchError("vcan0 went down", code="link_down")
    with pytest.raises(BenchError, match="went down"):
        exchange.clear()
