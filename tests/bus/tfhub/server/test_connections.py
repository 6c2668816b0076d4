"""What a hub owes one peer: nothing is lost for a member, an observer's ring drops the oldest and counts."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.tfhub.records import CLASSIC, DROPPED, HEAD, pack_frames
from tunefree_hil.bus.tfhub.server.connections import Peer


@pytest.fixture
def pair() -> Iterator[tuple[Peer, socket.socket]]:
    here, there = socket.socketpair()
    here.setblocking(False)
    there.setblocking(False)
    with here, there:
        yield Peer(here, "vehicle", 0.0), there


def chunk(first: int, count: int) -> bytes:
    return pack_frames([CanFrame(1, (first + i).to_bytes(8, "little")) for i in range(count)])


def drain(there: socket.socket) -> bytes:
    data = b""
    while True:
        try:
            data += there.recv(1 << 20)
        except BlockingIOError:
            return data


def numbers_and_drops(data: bytes) -> tuple[list[int], int]:
    numbers, drops, at = [], 0, 0
    while at < len(data):
        size, kind, _, sequence, _ = HEAD.unpack_from(data, at)
        if kind == DROPPED:
            drops = sequence
        else:
            assert size == CLASSIC.size
            numbers.append(int.from_bytes(data[at + 28 : at + 36], "little"))
        at += size
    return numbers, drops


def test_a_member_gets_all(pair: tuple[Peer, socket.socket]) -> None:
    peer, there = pair
    for first in range(0, 40_000, 50):
        peer.enqueue(chunk(first, 50), 50)
    data = b""
    while not peer.flush():
        data += drain(there)
    data += drain(there)
    assert numbers_and_drops(data) == (list(range(40_000)), 0)
    assert peer.queued_bytes == 0 and not peer.queue


@given(st.lists(st.tuples(st.integers(1, 60), st.booleans(), st.booleans()), max_size=60))
def test_an_observer_gets_all_that_is_not_counted_as_dropped(steps: list[tuple[int, bool, bool]]) -> None:
    here, there = socket.socketpair()
    here.setblocking(False)
    there.setblocking(False)
    here.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)  # the least there is: writes are often partial
    with here, there:
        peer, data, given_count = Peer(here, "vehicle", 0.0, role="observer"), b"", 0
        for count, flush, read in steps:
            peer.enqueue(chunk(given_count, count), count, 4000)
            given_count += count
            assert peer.queued_bytes <= 4000 or peer.begun
            if flush:
                peer.flush()
            if read:
                data += drain(there)
        while not peer.flush():
            data += drain(there)
        data += drain(there)
        numbers, drops = numbers_and_drops(data)
        assert numbers == sorted(set(numbers)) and len(numbers) + peer.dropped == given_count
        assert drops == peer.dropped and peer.queued_bytes == 0
