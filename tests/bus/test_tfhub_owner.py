"""Owners: logs, numbers, and that no hub outlives its owner."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from tests.bus.tfhub_help import PATIENCE_S, ThreadHub, eventually, frame, number_of, thread_hub
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bus.tfhub import reception
from tunefree_hil.bus.tfhub.owner import Owner
from tunefree_hil.bus.tfhub.plugin import HubBus, HubGone
from tunefree_hil.bus.tfhub.server.hub import Hub, HubOptions
from tunefree_hil.bus.tfhub.server.serve import serve
from tunefree_hil.bus.tfhub.session import Session


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[ThreadHub]:
    with thread_hub(tmp_path) as running:
        yield running


def test_owners(hub: ThreadHub) -> None:
    with pytest.raises(InputError, match="has an owner already: owner"):
        Owner(hub.session)


def test_the_hub_ends_when_its_owner_goes(tmp_path: Path) -> None:
    hub = ThreadHub(tmp_path)
    a = hub.member("a")
    hub.owner._connection.sock.close()
    with pytest.raises(HubGone, match=r"hub .*hub \(pid \d+\) at unix:.* is gone: its owner owner is gone"):
        a.recv(PATIENCE_S)
    with pytest.raises(HubGone):
        a.recv_frames(PATIENCE_S)
    with pytest.raises(HubGone, match="is gone"):
        a.send_frames([frame(1)])
    assert a.state is can.BusState.ERROR
    a.shutdown()
    hub.close()
    assert hub.why == "its owner owner is gone" and not Path(hub.session).exists()


def test_a_hub_whose_owner_never_comes_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reception, "OWNER_PATIENCE_S", 0.05)
    assert serve(str(tmp_path / "hub")) == "no owner came within 0.05 s"


def test_a_standalone_hub_lets_owners_come_and_go(tmp_path: Path) -> None:
    session = str(tmp_path / "hub")
    hub = Hub(Session(session, "unix", "real"), HubOptions(standalone=True))
    thread = threading.Thread(target=hub.run)
    thread.start()
    try:
        for number in range(2):
            with Owner(session) as owner, HubBus(f"{session}/veh?role=member") as bus:
                owner.start_log({"vehicle": tmp_path / f"{number}.log"})
                bus.send_frames([frame(1)])
                eventually(lambda owner=owner, n=number: owner.stats().frames["vehicle"] == n + 1)
        eventually(lambda: (tmp_path / "1.log.part").read_text())  # nobody stopped it: cut off, but readable
        assert not (tmp_path / "1.log").exists()
    finally:
        hub.stop("the test is over")
        thread.join(PATIENCE_S)
    assert not Path(session).exists()


def test_logs(hub: ThreadHub, tmp_path: Path) -> None:
    with hub.member("a") as a, hub.member("a", "bench") as bench:
        a.send_frames([frame(0)])  # before the log
        eventually(lambda: hub.owner.stats().frames["vehicle"] == 1)
        hub.owner.start_log({"vehicle": tmp_path / "v.log", "bench": tmp_path / "b.log"})
        with pytest.raises(BenchError, match="already"):
            hub.owner.start_log({"vehicle": tmp_path / "w.log"})
        for number in range(1, 1001):
            a.send_frames([frame(number)])
        bench.send_frames([frame(1)])
        eventually(lambda: sum(hub.owner.stats().frames.values()) == 1002)
        assert hub.owner.stop_log() == {"vehicle": 1000, "bench": 1}
        a.send_frames([frame(1001)])
    found = list(can.LogReader(str(tmp_path / "v.log")))
    assert [number_of(message.data) for message in found] == list(range(1, 1001))
    assert {message.channel for message in found} == {"can0"}
    assert [message.channel for message in can.LogReader(str(tmp_path / "b.log"))] == ["bench"]
    with pytest.raises(BenchError, match="no log"):
        hub.owner.stop_log()


def test_a_log_that_cannot_begin_leaves_nothing(hub: ThreadHub, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="No such file"):
        hub.owner.start_log({"vehicle": tmp_path / "v.log", "bench": tmp_path / "nowhere" / "b.log"})
    assert not list(tmp_path.glob("*.log*"))
    hub.owner.start_log({"vehicle": tmp_path / "v.log"})  # and the next one may
    assert hub.owner.stop_log() == {"vehicle": 0}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_disk_hurts_only_the_log(hub: ThreadHub, tmp_path: Path) -> None:
    (tmp_path / "v.log.part").symlink_to("/dev/full")
    with hub.member("a") as a, hub.member("b") as b:
        hub.owner.start_log({"vehicle": tmp_path / "v.log", "bench": tmp_path / "b.log"})
        for number in range(200):
            a.send_frames([frame(number + i) for i in range(50)])
        got = 0
        while got < 10_000:
            got += len(b.recv_frames(PATIENCE_S))
        with pytest.raises(BenchError, match="No space left") as raised:
            hub.owner.stop_log()
        assert raised.value.file == str(tmp_path / "v.log")
        assert (tmp_path / "b.log").exists()  # the other one is whole
        a.send_frames([frame(1)])
        assert b.recv_frames(PATIENCE_S)


def test_stats(hub: ThreadHub) -> None:
    with hub.member("a") as a, hub.observer("o", "bench"):
        a.send_frames([frame(1)] * 3)
        eventually(lambda: hub.owner.stats().frames == {"vehicle": 3, "bench": 0})
        stats = hub.owner.stats()
        assert {(peer.name, peer.channel, peer.role) for peer in stats.peers} == {
            ("owner", "bench", "owner"),
            ("a", "vehicle", "member"),
            ("o", "bench", "observer"),
        }
        assert [peer.sent for peer in stats.peers if peer.name == "a"] == [3]
        assert [peer.dropped for peer in stats.peers if peer.role == "observer"] == [0]
