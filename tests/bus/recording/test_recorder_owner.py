"""The owner's end of a recorder's socket pair: what it is told, when, and what a recorder that is gone looks like."""

from __future__ import annotations

import errno
import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.bus.recording.test_frame_attribution import REPORTS, TICK_NS, drive
from tests.bus.recording.test_recorder import SETUP, Bus
from tunefree_hil.base.errors import BenchError, NoAnswer
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.recording import recorder as module
from tunefree_hil.bus.recording import recorder_process
from tunefree_hil.bus.recording.recorder import Recorder, RecorderSetup
from tunefree_hil.bus.recording.recorder_owner import BusTrouble, RecorderOwner


class Served:
    """A recorder's process as a thread, over a fake bus."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bus = Bus(folder)
        monkeypatch.setattr(recorder_process, "open_recorder", self._open)
        ours, theirs = socket.socketpair()
        self.thread = threading.Thread(target=self._serve, args=(theirs,), daemon=True)
        self.thread.start()
        self.owner = RecorderOwner(ours, SETUP, 5.0)

    def _open(self, setup: RecorderSetup) -> Recorder:
        assert (setup.vehicle, setup.tick_ns, list(setup.ids[0])) == (SETUP.vehicle, TICK_NS, REPORTS)
        return self.bus.recorder

    def _serve(self, control: socket.socket) -> None:
        with control:
            recorder_process.serve(control)

    def close(self) -> None:
        self.owner.close()
        self.thread.join(5.0)
        assert not self.thread.is_alive(), "a recorder ends with its owner"
        self.bus.close()


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setattr(module, "SETTLE_S", 0.02)
    one = Served(tmp_path, monkeypatch)
    yield one
    one.close()


def test_an_owner_starts_and_stops_logs(served: Served) -> None:
    frames, messages = drive(4)
    served.owner.start_log(served.bus.paths)
    served.bus.channel.say(*messages)
    served.bus.sock.arrive(*frames, CanFrame(0x7FE, b"x"))
    assert served.owner.stop_log() == {"vehicle": len(frames) + 1, "bench": len(messages)}
    assert served.owner.foreign == {0x7FE: 1}
    assert served.owner.stats().frames == {"vehicle": len(frames) + 1, "bench": len(messages)}
    served.owner.check()
    assert len(served.bus.log()) == len(frames) + 1


def test_an_owner_hears_of_trouble_at_once_and_once(served: Served) -> None:
    served.owner.start_log(served.bus.paths)
    served.bus.sock.fail(errno.ENETDOWN)
    with pytest.raises(BusTrouble, match="can9 went down") as caught:
        for _ in range(500):
            served.owner.stats()
            served.owner.check()
    assert caught.value.code == "link_down"
    assert served.owner.stop_log()["vehicle"] == 0
    served.owner.start_log(served.bus.paths)
    served.bus.sock.drop(2)
    with pytest.raises(BusTrouble, match="2 frames"):
        served.owner.stop_log()


def test_an_owner_hears_of_a_file_that_cannot_be_written(served: Served, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="cannot be written"):
        served.owner.start_log({"vehicle": tmp_path / "none" / "v.log"})


def test_a_recorder_that_is_gone_or_silent_is_named() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        with pytest.raises(NoAnswer, match=r"did not answer setup within 0\.05 s"):
            RecorderOwner(ours, SETUP, 0.05)
        assert json.loads(theirs.recv(4096))["vehicle"] == "socketcan:can9"
    ours, theirs = socket.socketpair()
    theirs.close()
    with ours, pytest.raises(BenchError, match="the recorder is gone"):
        RecorderOwner(ours, SETUP, 1.0)


def test_a_link_that_does_not_open_is_the_owners_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(setup: RecorderSetup) -> Any:
        raise BenchError("socketcan:can9 does not open", code="bus_error")

    monkeypatch.setattr(recorder_process, "open_recorder", refuse)
    ours, theirs = socket.socketpair()
    failed: list[BenchError] = []

    def serve() -> None:
        try:
            recorder_process.serve(theirs)
        except BenchError as error:
            failed.append(error)

    thread = threading.Thread(target=serve)
    thread.start()
    with ours, theirs:
        with pytest.raises(BenchError, match="does not open"):
            RecorderOwner(ours, SETUP, 5.0)
        thread.join(5.0)
    assert [error.code for error in failed] == ["bus_error"]
