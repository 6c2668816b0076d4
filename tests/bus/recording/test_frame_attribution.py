"""Frames get their tick whatever the interleaving of the two channels; a foreign sender is named."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import BenchError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.recording.frame_attribution import Ledger, can_key, digest
from tunefree_hil.bus.socketcan.kernel_frames import pack, unpack
from tunefree_hil.bus.tfhub.records import EFF_FLAG, ERR_FLAG, RTR_FLAG, Raw

REPORTS, COMMANDS = [0x61, 0x63, 0x100 | EFF_FLAG], [0x60, 0x62]
TICK_NS = 10_000_000


def raw(frame: CanFrame, time_ns: int = 7) -> Raw:
    return unpack(pack(frame), time_ns)


class Written:
    """A ledger and what it wrote."""

    def __init__(self, tick_ns: int = TICK_NS) -> None:
        self.frames: list[Raw] = []
        self.ledger = Ledger((REPORTS, COMMANDS), tick_ns, self.frames.append)

    @property
    def lines(self) -> list[tuple[int, int, bytes]]:
        return [(one.time_ns // TICK_NS, one.can_id, one.data) for one in self.frames]


def tick(k: int) -> tuple[list[CanFrame], list[CanFrame]]:
    """(reports, commands) of a tick; ids fall due at different rates."""
    reports = [CanFrame(0x63, bytes([k, 0])), CanFrame(0x61, bytes([k, 1]))]
    if k % 2:
        reports.append(CanFrame(0x100, bytes([k, 2]), True))
    return reports, [CanFrame(0x60, bytes([k, 3])), CanFrame(0x62, bytes([k, 4]))] if k % 3 else []


def done(k: int, phase: int, frames: list[CanFrame]) -> bc.Done:
    return bc.Done(k, phase, len(frames), digest(sorted(frames, key=can_key)))


def drive(ticks: int) -> tuple[list[CanFrame], list[object]]:
    """(the vehicle's frames in order, the bench's messages in order)."""
    frames: list[CanFrame] = []
    messages: list[object] = []
    for k in range(ticks):
        messages.append(bc.Tick(k))
        for phase, sent in enumerate(tick(k)):
            frames += sent
            messages.append(done(k, phase, sent))
    return frames, [*messages, bc.Status(bc.Role.ECU, bc.State.FINISHED, 0, ticks)]


@given(st.integers(0, 1 << 32), st.integers(1, 12))
def test_any_interleaving_of_the_channels_gives_the_same_log(seed: int, ticks: int) -> None:
    frames, messages = drive(ticks)
    chance = random.Random(seed)
    one = Written()
    left, right = list(frames), list(messages)
    while left or right:
        if left and (not right or chance.random() < 0.5):
            one.ledger.vehicle(raw(left.pop(0)))
        else:
            one.ledger.bench(right.pop(0))
    assert one.ledger.settled
    expected = [(k, can_key(frame), frame.data) for k in range(ticks) for sent in tick(k) for frame in sent]
    assert one.lines == expected


def test_a_drive_is_not_settled_before_all_has_come() -> None:
    frames, messages = drive(2)
    one = Written()
    for message in messages:
        one.ledger.bench(message)
    assert one.ledger.ended and not one.ledger.settled
    assert one.ledger.missing() == (0, "ecu", 2)
    for frame in frames[:-1]:
        one.ledger.vehicle(raw(frame))
    assert one.ledger.missing() == (1, "controller", 1)
    one.ledger.vehicle(raw(frames[-1]))
    assert one.ledger.settled and one.ledger.missing() == (0, "", 0)


def test_foreign_error_and_remote_frames_are_counted_and_keep_their_place() -> None:
    one = Written()
    reports, _ = tick(0)
    odd = [CanFrame(0x7FF, b"?"), CanFrame(0x61, b"z", True)]
    error = Raw(ERR_FLAG | 4, bytes(8), 7)
    remote = Raw(0x61 | RTR_FLAG, b"", 7, length=8)
    one.ledger.vehicle(raw(reports[0]))
    for other in (*map(raw, odd), error, remote):
        one.ledger.vehicle(other)
    one.ledger.vehicle(raw(reports[1]))
    assert one.frames == [], "nothing is written before the tick is known"
    one.ledger.bench(bc.Done(3, 0, 2, digest(sorted(reports, key=can_key))))
    ids = [0x63, 0x7FF, 0x61 | EFF_FLAG, ERR_FLAG | 4, 0x61 | RTR_FLAG, 0x61]
    assert [frame.can_id for frame in one.frames] == ids
    assert {frame.time_ns for frame in one.frames} == {3 * TICK_NS}
    assert one.ledger.foreign == {0x7FF: 1, 0x61 | EFF_FLAG: 1}
    assert one.ledger.remote == 1


@pytest.mark.parametrize(("phase", "code"), [(0, "foreign_reporter"), (1, "foreign_commander")])
def test_a_foreign_sender_of_our_ids_is_named(phase: int, code: str) -> None:
    one = Written()
    sent = tick(1)[phase]
    one.ledger.vehicle(raw(sent[0]._replace(data=b"other")))
    one.ledger.vehicle(raw(sent[0]))
    with pytest.raises(BenchError, match=r"foreign .* at tick 1: .* another node sends them") as caught:
        one.ledger.bench(done(1, phase, sent[:1]))
    assert caught.value.code == code
    one.ledger.finish()
    assert len(one.frames) == 2, "both stay in the log"


def test_after_a_loss_nobody_is_accused() -> None:
    one = Written()
    one.ledger.claiming = False
    reports, _ = tick(1)
    one.ledger.vehicle(raw(reports[1]))
    one.ledger.bench(done(1, 0, reports))
    one.ledger.vehicle(raw(reports[0]))
    one.ledger.vehicle(raw(reports[2]))
    assert len(one.frames) == 3


def test_real_time_keeps_the_kernels_stamps_and_waits_for_nothing() -> None:
    one = Written(0)
    frames, messages = drive(2)
    for i, frame in enumerate(frames):
        one.ledger.vehicle(raw(frame, 1_700_000_000_000_000_000 + i))
    assert [frame.time_ns - 1_700_000_000_000_000_000 for frame in one.frames] == list(range(len(frames)))
    for message in messages:
        one.ledger.bench(message)
    assert one.ledger.settled


def test_an_unclaimed_rest_is_written_at_the_end() -> None:
    one = Written()
    reports, commands = tick(1)
    for frame in reports:
        one.ledger.vehicle(raw(frame))
    one.ledger.bench(done(1, 0, reports))
    one.ledger.vehicle(raw(commands[0]))
    one.ledger.finish()
    assert [line[0] for line in one.lines] == [1, 1, 1, 1]
