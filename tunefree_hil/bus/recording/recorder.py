"""The recorder: reads a vehicle's SocketCAN link and the bench channel, and writes the logs of both.

A hub writes its logs itself. SocketCAN has no hub, so the runner starts a recorder in a process of its own
(recorder_process.py, recorder_owner.py): while a runner grades an episode for 50 ms, a queue of the kernel would
overflow.

Trouble on the bus (frames lost, link down, bus-off, a foreign sender) is kept, only the first, until the next episode;
the log goes on.
"""

from __future__ import annotations

import select
from functools import partial
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, TunefreeError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.error_frames import note_error
from tunefree_hil.bus.link import HubLink
from tunefree_hil.bus.open import LinkRequest, open_link
from tunefree_hil.bus.recording.frame_attribution import Ledger, can_key
from tunefree_hil.bus.socketcan.kernel_link import kernel_drops
from tunefree_hil.bus.socketcan.link import SocketCanLink, overflow, realtime_offset_ns
from tunefree_hil.bus.tfhub.records import EFF_MASK, ERR_FLAG, Raw, pack_raw
from tunefree_hil.bus.tfhub.server.log import CandumpLog, close_logs, open_logs

SETTLE_S = 1.0  # how long the end of a log waits for frames that were announced; SocketCAN delivers at once
LOOK_S = 0.01
MOST_OLD = 30_000  # frames that came before an episode, as many as wait in a queue of 16 MiB; a flood has no end
LOG_SLICE = 256  # frames made into text at a time
NOT_WHOLE = ("rx_overflow", "link_down", "bus_error", "frames_missing")  # trouble after which a log lacks frames


class RecorderSetup(NamedTuple):
    """The owner's first message. ids: (of reports, of commands), EFF bit included; tick_ns 0 in real time."""

    vehicle: str
    bench: str
    ids: tuple[list[int], list[int]]
    tick_ns: int
    fd: bool


class Recorder:
    """Both links and, while an episode is driven, its logs."""

    def __init__(self, setup: RecorderSetup, vehicle: SocketCanLink, bench: SocketCanLink | HubLink) -> None:
        self.setup = setup
        self.vehicle = vehicle
        self.bench = bench
        self.frames = {"vehicle": 0, "bench": 0}  # received since it was started
        self.trouble: TunefreeError | None = None
        self.fds = (vehicle.fileno(), bench.fileno())
        self._logs: dict[str, CandumpLog] = {}
        self._ledger: Ledger | None = None
        self._drops = 0
        self._bench_name = setup.bench.rpartition(":")[2] if setup.bench.startswith("socketcan:") else "bench"

    def read(self) -> int:
        """Read both links; returns the number of frames. Trouble is kept. BenchError when the hub is gone."""
        before = sum(self.frames.values())
        try:
            raws = self.vehicle.receive_raw(0.0)
            self._require_all()
            self.frames["vehicle"] += len(raws)
            for raw in raws:
                self._receive_vehicle(raw)
            self._read_bench()
        except BenchError as error:
            if error.code == "hub_gone":
                raise
            self._note(error)
        return sum(self.frames.values()) - before

    def work(self) -> bool:
        """Make text of some frames; True while more wait."""
        for log in self._logs.values():
            if log.waiting:
                log.work(LOG_SLICE)
        return any(log.waiting for log in self._logs.values())

    def start(self, paths: dict[str, str]) -> None:
        """Begin an episode; earlier frames belong to none. BenchError when a file cannot be made."""
        if self._logs:
            raise BenchError("a log is being written already", code="log_runs", hint="stop it first")
        left = MOST_OLD
        while left > 0 and (n_frames := self.read()):
            left -= n_frames
        self.trouble = None  # of frames before the episode
        self._forgive()
        names = {"vehicle": self.vehicle.interface, "bench": self._bench_name}
        self._logs = open_logs(paths, names, 0)
        reports, commands = self.setup.ids
        self._ledger = Ledger((reports, commands), self.setup.tick_ns, partial(self._write, "vehicle"))

    def stop(self) -> dict[str, Any]:
        """Finish the logs: counts of frames, foreign ids and errors. Trouble at the end is noted too.

        Logs that lack frames keep their temporary names.
        """
        if self._ledger is None:
            raise BenchError("no log is being written", code="no_log", hint="start_log comes first")
        ledger = self._settle(self._ledger)
        self._ledger = None
        ledger.finish()
        logs, self._logs = self._logs, {}
        if self.trouble is not None and self.trouble.code in NOT_WHOLE:
            for log in logs.values():
                log.abandon()
        else:
            close_logs(logs.values())
        return {
            "frames": {channel: log.frames for channel, log in logs.items()},
            "foreign": {f"{key:X}": count for key, count in ledger.foreign.items()},
            "remote": ledger.remote,
            "errors": dict(self.vehicle.errors),
        }

    def close(self) -> None:
        """Leave both links; a log that was not stopped keeps its temporary name."""
        for log in self._logs.values():
            log.abandon()
        self.vehicle.close()
        self.bench.close()

    def _settle(self, ledger: Ledger) -> Ledger:
        """Wait for announced frames that have not arrived; note the missing ones."""
        looks = round(SETTLE_S / LOOK_S)
        while not ledger.settled and self.trouble is None and looks:
            looks -= 1
            select.select(self.fds, [], [], LOOK_S)
            self.read()
        self.read()
        lost = self.vehicle.count_lost()
        dropped = kernel_drops(self.vehicle.interface) - self._drops
        self._require_all()
        if dropped > 0:
            self._note(overflow(self.vehicle.interface, "the kernel (net.core.netdev_max_backlog)", dropped))
        missing = ledger.missing()
        if missing.count and ledger.ended and not lost:
            words = (
                f"tick {missing.tick}: {missing.count} frames that the {missing.sender} announced never came over "
                f"{self.vehicle.interface}"
            )
            self._note(BenchError(words, code="frames_missing"))
        return ledger

    def _forgive(self) -> None:
        self.vehicle.forgive()
        if isinstance(self.bench, SocketCanLink):
            self.bench.forgive()
        self.vehicle.errors.clear()
        self._drops = kernel_drops(self.vehicle.interface)

    def _note(self, error: TunefreeError) -> None:
        """Keep the first trouble; frames that were lost outside an episode are none."""
        if self.trouble is None and (self._ledger is not None or error.code != "rx_overflow"):
            self.trouble = error

    def _require_all(self) -> None:
        """Note frames that were lost in an episode, before later frames are attributed wrongly."""
        try:
            self.vehicle.require_all()
        except BenchError as error:
            if self._ledger is not None:
                self._ledger.claiming = False
                self._note(error)

    def _receive_vehicle(self, raw: Raw) -> None:
        """Log one frame of the vehicle channel, of any kind."""
        try:
            if self._ledger is not None:
                self._ledger.vehicle(raw)
            if raw.can_id & ERR_FLAG:
                note_error(self.vehicle.errors, raw.can_id & EFF_MASK, raw.data, self.vehicle.interface)
        except BenchError as error:
            self._note(error)

    def _read_bench(self) -> None:
        offset_ns = 0 if self.setup.tick_ns else realtime_offset_ns()
        for frame in self.bench.receive(0.0):
            self.frames["bench"] += 1
            if self._ledger is not None:
                self._receive_bench(self._ledger, frame, offset_ns)

    def _receive_bench(self, ledger: Ledger, frame: CanFrame, offset_ns: int) -> None:
        try:
            ledger.bench(bc.decode(frame))
        except BenchError as error:
            self._note(error)
        tick_ns = self.setup.tick_ns
        time_ns = ledger.tick * tick_ns if tick_ns else round(frame.time_s * 1e9) + offset_ns
        self._write("bench", Raw(can_key(frame), frame.data, time_ns, frame.fd))

    def _write(self, channel: str, raw: Raw) -> None:
        log = self._logs.get(channel)
        if log is not None:
            log.add(pack_raw(raw), 1)


def open_recorder(setup: RecorderSetup) -> Recorder:
    """Open both links to listen; on a hub as a member, for which the hub waits. BenchError, InputError as open_link."""
    vehicle = open_link(setup.vehicle, "vehicle", LinkRequest("the recorder", role="observer", fd=setup.fd))
    assert isinstance(vehicle, SocketCanLink)
    try:
        role = "observer" if setup.bench.startswith("socketcan:") else "member"
        bench = open_link(setup.bench, "bench", LinkRequest("recorder", role=role))
    except BaseException:
        vehicle.close()
        raise
    assert isinstance(bench, SocketCanLink | HubLink)
    return Recorder(setup, vehicle, bench)
