"""What is no hello, no record or no good manners costs its own connection, and nobody else's."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.bus.tfhub_help import (
    PATIENCE_S,
    ThreadHub,
    frame,
    hello,
    last_word,
    number_of,
    raw_connection,
    thread_hub,
)
from tunefree_hil.base.errors import PeerGone
from tunefree_hil.bus.tfhub import reception, records
from tunefree_hil.bus.tfhub.plugin import HubGone


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[ThreadHub]:
    with thread_hub(tmp_path) as running:
        yield running


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"\x00" * 40, "no records"),
        (b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", "no records"),
        (records.pack_raw(records.Raw(1, b"x")), "as an unidentified peer"),
        (records.pack_control(records.BYE), "may not send"),
        (records.pack_control(records.HELLO, {}), "no role"),
        (records.pack_control(records.REQUEST, {"op": "stats"}), "may not send"),
        (hello(name="x") + records.pack_control(records.REQUEST, {"op": "stats"}), "may not send"),
        (hello(name="x") + hello(name="x"), "may not send"),
        (hello(name="x", role="owner2"), "no role"),
        (hello(name="x", only=5), "no list of ids"),
        (hello(name="x", only=[[]]), "no list of ids"),
        (hello(name=["x"]), "no role"),
        (hello(name="x", both="yes", echo=[], listen={}, stamps=1, token=3) + b"\xff" * 20, "no records"),
        (records.HEAD.pack(records.HEAD.size + 10_000, records.HELLO, 0, 0, 0) + b"[" * 10_000, "without JSON"),
        (records.HEAD.pack(21, records.HELLO, 0, 0, 0) + b"{", "without JSON"),
    ],
)
def test_garbage_before_hello(hub: ThreadHub, data: bytes, why: str) -> None:
    with hub.member("a") as a, hub.member("b") as b, raw_connection(hub) as sock:
        sock.sendall(data)
        assert why in last_word(sock)["message"]
        assert any("dropped" in line and why in line for line in hub.said)
        a.send_frames([frame(1)])
        try:
            assert b.recv_frames(PATIENCE_S)
        except PeerGone as error:
            assert error.peer == "x" and b.recv_frames(PATIENCE_S)


def test_random_garbage_never_hurts(hub: ThreadHub) -> None:
    rng = np.random.default_rng(1)
    with hub.member("a") as a, hub.member("b") as b:
        for number in range(40):
            with raw_connection(hub) as sock:
                start = hello(name=f"fuzz{number}") if number % 2 else b""
                never = records.HEAD.pack(7, 99, 0, 0, 0)  # so that it is not just the beginning of a record
                try:
                    sock.sendall(start + rng.bytes(int(rng.integers(0, 3000))) + never * 4000)
                    while sock.recv(65536):
                        pass
                except ConnectionError:  # thrown out while we were still sending
                    continue
        a.send_frames([frame(7)])
        losses, got = 0, False
        while not got:
            try:
                got = any(found.data == frame(7).data for found in b.recv_frames(PATIENCE_S))
            except PeerGone as error:
                assert error.peer.startswith("fuzz")
                losses += 1
        assert losses == 20
        assert {peer.name for peer in hub.owner.stats().peers} == {"a", "b", "owner"}


def test_garbage_after_hello_is_named(hub: ThreadHub) -> None:
    with hub.member("a") as a, raw_connection(hub) as sock:
        sock.sendall(hello(name="mad") + records.pack_frames([frame(1)]) + b"\xff" * 100)
        assert number_of(a.recv_frames(PATIENCE_S)[0].data) == 1
        with pytest.raises(PeerGone, match="mad is gone from the bus: the hub dropped it") as raised:
            a.recv_frames(PATIENCE_S)
        assert raised.value.peer == "mad"
        assert "no records" in last_word(sock)["message"]


def test_a_frame_that_is_too_long_is_garbage(hub: ThreadHub) -> None:
    bad = bytearray(records.pack_frames([frame(1)]))
    bad[records.LEN_AT] = 9
    with hub.member("a") as a, hub.member("b") as b:
        b._connection.sock.send(bytes(bad))
        with pytest.raises(PeerGone, match="b is gone"):
            a.recv_frames(PATIENCE_S)
        with pytest.raises(HubGone, match="a frame that is too long"):
            b.recv_frames(PATIENCE_S)


def test_hello_must_come_soon(hub: ThreadHub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reception, "HELLO_PATIENCE_S", 0.1)
    with raw_connection(hub) as sock:
        assert "sent no hello within" in last_word(sock)["message"]
    assert any("sent no hello within" in line for line in hub.said)


def test_another_protocol_is_refused(hub: ThreadHub) -> None:
    with raw_connection(hub) as sock:
        sock.sendall(hello(protocol=0))
        assert last_word(sock)["code"] == "protocol"
