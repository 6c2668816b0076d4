"""The recorder over a fake SocketCAN link and a bench channel in memory: whole logs, equal hashes, trouble by name."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.bus.fake_can import FakeSocket, error_frame
from tests.bus.recording.test_frame_attribution import COMMANDS, REPORTS, TICK_NS, drive
from tests.nodes.memory import FakeLink
from tunefree_hil.base.errors import BenchError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.recording import recorder as module
from tunefree_hil.bus.recording.recorder import Recorder, RecorderSetup
from tunefree_hil.bus.socketcan.link import SocketCanLink
from tunefree_hil.episode.candump import ERROR, LogFrame, read_candump
from tunefree_hil.episode.frame_hash import frame_hash

SETUP = RecorderSetup("socketcan:can9", "tfhub:s/bench", (REPORTS, COMMANDS), TICK_NS, False)


class Bus:
    """A recorder whose links a test feeds."""

    def __init__(self, folder: Path, setup: RecorderSetup = SETUP) -> None:
        self.folder = folder
        self.sock = FakeSocket()
        self.channel = FakeLink()
        self._pipe = socket.socketpair()
        vehicle = SocketCanLink(self.sock, "can9", "the recorder")
        self.channel.fileno = self._pipe[0].fileno  # type: ignore[attr-defined]
        self.recorder = Recorder(setup, vehicle, self.channel)  # type: ignore[arg-type]
        self.paths = {"vehicle": folder / "vehicle.log", "bench": folder / "bench.log"}

    def start(self) -> None:
        self.recorder.start({channel: str(path) for channel, path in self.paths.items()})

    def log(self, channel: str = "vehicle") -> list[LogFrame]:
        return read_candump(self.paths[channel])

    def close(self) -> None:
        self.recorder.close()
        self.sock.close()
        for end in self._pipe:
            end.close()


@pytest.fixture
def bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bus]:
    monkeypatch.setattr(module, "SETTLE_S", 0.02)
    one = Bus(tmp_path)
    yield one
    one.close()


def test_an_episode_is_recorded_as_a_hub_records_it(bus: Bus) -> None:
    frames, messages = drive(6)
    bus.start()
    for at in range(0, len(frames), 5):
        bus.sock.arrive(*frames[at : at + 5])
        bus.recorder.read()
    bus.channel.say(*messages)
    done = bus.recorder.stop()
    assert done["frames"] == {"vehicle": len(frames), "bench": len(messages)}
    assert (done["foreign"], done["remote"], done["errors"], bus.recorder.trouble) == ({}, 0, {}, None)
    log = bus.log()
    assert [frame.data for frame in log] == [frame.data for frame in frames], "the order of the bus"
    assert [frame.time_s for frame in log] == pytest.approx([frame.data[0] * 0.01 for frame in frames])
    assert {frame.channel for frame in log} == {"can9"}
    # the hash is that of a log whose stamps the senders made, whatever its order within a phase
    stamped = [LogFrame(f.data[0] * 0.01, "can0", f.id | (f.extended << 31), f.data) for f in reversed(frames)]
    found, other = (frame_hash(one, 0.01, COMMANDS, REPORTS) for one in (log, stamped))
    assert found.hex == other.hex and found.frames == len(frames)
    assert [bc.decode(CanFrame(f.can_id, f.data)) for f in bus.log("bench")] == messages


def test_foreign_and_error_frames_are_counted_and_visible_but_not_hashed(bus: Bus) -> None:
    frames, messages = drive(3)
    clean = frame_hash([LogFrame(f.data[0] * 0.01, "x", f.id | (f.extended << 31), f.data) for f in frames],
                       0.01, COMMANDS, REPORTS).hex  # fmt: skip
    bus.start()
    bus.sock.arrive(*frames[:4], CanFrame(0x7FF, b"?"), error_frame(0x04, 0x20), *frames[4:])
    bus.channel.say(*messages)
    done = bus.recorder.stop()
    assert (done["foreign"], done["errors"]) == ({"7FF": 1}, {"controller": 1, "tx_passive": 1})
    log = bus.log()
    assert [i for i, frame in enumerate(log) if frame.can_id == 0x7FF or frame.flags & ERROR] == [4, 5]
    found = frame_hash(log, 0.01, COMMANDS, REPORTS)
    assert (found.hex, found.foreign, found.errors) == (clean, {0x7FF: 1}, 1)


def trouble_of(bus: Bus, code: str) -> BenchError:
    found = bus.recorder.trouble
    assert isinstance(found, BenchError) and found.code == code, found
    return found


def test_an_overflow_is_the_trouble_and_not_what_follows_from_it(bus: Bus) -> None:
    frames, messages = drive(6)
    bus.start()
    bus.sock.arrive(*frames[:7])
    bus.sock.drop(4)
    bus.sock.arrive(*frames[11:])
    bus.channel.say(*messages)
    bus.recorder.read()
    assert "4 frames of can9" in trouble_of(bus, "rx_overflow").message
    assert bus.recorder.stop()["frames"]["vehicle"] == len(frames) - 4
    assert not (bus.folder / "vehicle.log").exists(), "no log that looks whole"
    assert len(read_candump(bus.folder / "vehicle.log.part")) == len(frames) - 4


def test_a_loss_at_the_very_end_is_found_by_the_kernels_own_count(bus: Bus) -> None:
    frames, messages = drive(2)
    bus.start()
    bus.sock.arrive(*frames[:-1])
    bus.channel.say(*messages)
    bus.recorder.read()
    bus.sock.drop(1)
    bus.recorder.stop()
    assert "1 frame of can9" in trouble_of(bus, "rx_overflow").message


def test_frames_that_the_kernel_dropped_before_any_socket(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    drops = [100, 103]
    monkeypatch.setattr(module, "kernel_drops", lambda name: drops.pop(0))
    frames, messages = drive(1)
    bus.start()
    bus.sock.arrive(*frames)
    bus.channel.say(*messages)
    bus.recorder.stop()
    assert "3 frames of can9" in trouble_of(bus, "rx_overflow").message


def test_announced_frames_that_never_come_are_named(bus: Bus) -> None:
    frames, messages = drive(2)
    bus.start()
    bus.sock.arrive(*frames[:-1])
    bus.channel.say(*messages)
    bus.recorder.stop()
    assert "tick 1: 1 frames that the controller announced never came" in trouble_of(bus, "frames_missing").message


def test_a_foreign_command_is_trouble_and_the_rest_is_recorded(bus: Bus) -> None:
    frames, messages = drive(3)
    bus.start()
    bus.sock.arrive(CanFrame(0x60, b"mine!"), *frames)
    bus.channel.say(*messages)
    bus.recorder.read()
    trouble_of(bus, "foreign_commander")
    bus.recorder.stop()
    assert len(bus.log()) == len(frames) + 1


@pytest.mark.parametrize(("number", "words"), [(errno.ENETDOWN, "can9 went down"), (errno.ENODEV, "can9 is gone")])
def test_a_link_that_goes_in_an_episode(bus: Bus, number: int, words: str) -> None:
    bus.start()
    bus.sock.fail(number)
    bus.recorder.read()
    assert words in trouble_of(bus, "link_down").message
    bus.recorder.stop()
    assert sorted(path.name for path in bus.folder.glob("*.log*")) == ["bench.log.part", "vehicle.log.part"]


def test_bus_off_is_trouble_and_in_the_log(bus: Bus) -> None:
    bus.start()
    bus.sock.arrive(error_frame(0x40))
    bus.recorder.read()
    trouble_of(bus, "bus_off")
    bus.recorder.stop()
    assert [frame.flags & ERROR for frame in bus.log()] == [ERROR]


def test_what_came_before_an_episode_belongs_to_none(bus: Bus) -> None:
    bus.sock.arrive(CanFrame(0x60, b"old"), error_frame(0x04, 0x20))
    bus.sock.drop(8)
    bus.sock.arrive(CanFrame(0x7FF, b"old"))
    bus.recorder.read()
    assert bus.recorder.trouble is None
    bus.sock.arrive(CanFrame(0x60, b"older"))
    bus.start()
    frames, messages = drive(2)
    bus.sock.arrive(*frames)
    bus.channel.say(*messages)
    done = bus.recorder.stop()
    assert (done["foreign"], done["errors"], bus.recorder.trouble) == ({}, {}, None)
    assert len(bus.log()) == len(frames)


def test_a_flood_does_not_keep_an_episode_from_its_start(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody sends faster than we read: what waits in a queue is from before, and no more than that is read."""
    read = bus.recorder.read
    heard: list[int] = []

    def flooded() -> int:
        bus.sock.arrive(*[CanFrame(0x7FF, b"flood")] * 50)
        heard.append(read())
        return heard[-1]

    monkeypatch.setattr(module, "MOST_OLD", 120)
    monkeypatch.setattr(bus.recorder, "read", flooded)
    bus.start()
    assert heard == [50, 50, 50]


def test_a_log_that_cannot_be_made_leaves_nothing(bus: Bus, tmp_path: Path) -> None:
    bus.paths["bench"] = tmp_path / "none" / "bench.log"
    with pytest.raises(BenchError, match="cannot be written"):
        bus.start()
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(BenchError, match="no log is being written"):
        bus.recorder.stop()


def test_a_hub_that_is_gone_ends_the_recorder(bus: Bus) -> None:
    bus.channel.trouble = BenchError("the hub is gone", code="hub_gone")
    with pytest.raises(BenchError, match="the hub is gone"):
        bus.recorder.read()


def test_real_time_stamps_are_the_kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "realtime_offset_ns", lambda: 1_000_000_000)
    one = Bus(tmp_path, SETUP._replace(tick_ns=0))
    frames, messages = drive(2)
    one.start()
    one.sock.arrive(*frames)
    one.channel.say(*messages, time_s=2.5)
    one.recorder.stop()
    one.close()
    assert [frame.time_s for frame in one.log()] == pytest.approx([1.001 + 0.001 * i for i in range(len(frames))])
    assert {frame.time_s for frame in one.log("bench")} == {3.5}, "monotonic stamps become the same clock"
