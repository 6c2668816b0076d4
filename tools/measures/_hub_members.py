"""Measures a hub between real processes: round trips, a burst with three members, lockstep ticks.

For `measure hub`. Started as a process of its own, this module is one of the members: PART VEHICLE BENCH NUMBER.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tools.measures._hub_process import HubProcess, start_hub
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.tfhub.address import DEFAULT_TRANSPORT, Transport
from tunefree_hil.bus.tfhub.pair import HubPair
from tunefree_hil.bus.tfhub.plugin import HubBus

PATIENCE_S = 30.0
STOP_ID = 0x7FF
READY_ID = 0x7FE
TICK_ID, DONE_ID, ANSWER_ID = 0x10, 0x11, 0x300
TICK_FRAMES = 2  # TICK and DONE of phase 0
PHASE_FRAMES = (12, 3)  # vehicle frames a tick of ECU and controller, about those of the first vehicle


def measure_hub(rounds: int = 5000, transport: Transport = DEFAULT_TRANSPORT) -> dict[str, float]:
    """Round trip (us, p50 and p99), frames/s to each of two receivers, and a lockstep tick (us) of bus work alone.

    `rounds` of each; the burst has 4 frames for each round. The hub records all the while, as in an episode.
    """
    with tempfile.TemporaryDirectory() as folder:
        session = str(Path(folder) / "hub")
        with start_hub(session, clock="sender", transport=transport) as hub:
            hub.owner.start_log({name: Path(folder) / f"{name}.log" for name in ("vehicle", "bench")})
            trips_us = _round_trips(hub, rounds)
            rate_hz = _burst(hub, 4 * rounds)
            ticks_us = _ticks(hub, rounds)
            hub.owner.stop_log()
    return {
        "rounds": float(rounds),
        "round_trip_p50_us": _quantile(trips_us, 0.50),
        "round_trip_p99_us": _quantile(trips_us, 0.99),
        "burst_frames_per_s": rate_hz,
        "lockstep_tick_p50_us": _quantile(ticks_us, 0.50),
        "lockstep_tick_p99_us": _quantile(ticks_us, 0.99),
    }


def _quantile(values: list[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


@contextmanager
def _peer(kind: str, hub: HubProcess, number: int = 0) -> Iterator[subprocess.Popen[bytes]]:
    """A process of this module that plays one part, and ends on STOP_ID."""
    command = [sys.executable, "-m", "tools.measures._hub_members", kind, hub.vehicle, hub.bench, str(number)]
    process = subprocess.Popen(command)
    try:
        yield process
        process.wait(PATIENCE_S)
    finally:
        process.kill()
        process.wait()


def _until(bus: HubBus, identifier: int, count: int) -> None:
    """Receive until `count` frames of one id have come."""
    while count > 0:
        frames = bus.recv_frames(PATIENCE_S)
        if not frames:
            raise TimeoutError(f"{bus.name} received nothing for {PATIENCE_S} s")
        count -= sum(frame.id == identifier for frame in frames)


def _round_trips(hub: HubProcess, rounds: int) -> list[float]:
    """Times of one frame there and one frame back, in us."""
    bus = HubBus(hub.vehicle, role="member", name="asker")
    frame, stop = [CanFrame(0x100, bytes(8))], [CanFrame(STOP_ID, b"")]
    times = []
    with bus, _peer("echo", hub):
        _until(bus, READY_ID, 1)
        for _ in range(rounds):
            start_s = time.perf_counter()
            bus.send_frames(frame)
            bus.recv_frames(PATIENCE_S)
            times.append((time.perf_counter() - start_s) * 1e6)
        bus.send_frames(stop)
    return times


def _burst(hub: HubProcess, count: int) -> float:
    """Frames a second until two other members have received all, sent 50 at a time."""
    bus = HubBus(hub.vehicle, role="member", name="burster")
    batch = [CanFrame(0x200 + i, bytes(8)) for i in range(50)]
    with bus, _peer("drain", hub, 1), _peer("drain", hub, 2):
        _until(bus, READY_ID, 2)
        start_s = time.perf_counter()
        for _ in range(count // len(batch)):
            bus.send_frames(batch)
        bus.send_frames([CanFrame(STOP_ID, b"")])
        _until(bus, READY_ID, 2)
        elapsed_s = time.perf_counter() - start_s
    return (count // len(batch)) * len(batch) / elapsed_s


def _ticks(hub: HubProcess, count: int) -> list[float]:
    """Times of ticks in us, over joint connections as the nodes have them: phase 0 here, phase 1 in another process.

    A third process is on the bench channel and, as a runner, receives only its ids.
    """
    pair = HubPair(hub.vehicle, name="ecu", stamps=True)
    times = []
    try:
        with _peer("controller", hub), _peer("tuner", hub):
            _gather(pair, 1, READY_ID, 2)
            for tick in range(count):
                start_s = time.perf_counter()
                time_s = tick * 0.01
                phase = [CanFrame(0x100 + i, bytes(8), False, False, time_s) for i in range(PHASE_FRAMES[0])]
                pair.send(phase, [CanFrame(TICK_ID, bytes(8), False, False, time_s)] * TICK_FRAMES)
                _gather(pair, 1, DONE_ID, 1)
                _gather(pair, 0, ANSWER_ID, PHASE_FRAMES[1])
                times.append((time.perf_counter() - start_s) * 1e6)
            pair.send([], [CanFrame(STOP_ID, b"")])
    finally:
        pair.close()
    return times


def _gather(pair: HubPair, channel: int, identifier: int, count: int) -> None:
    """Receive on a channel until `count` frames of one id have come."""
    while count > 0:
        frames = pair.receive(channel, PATIENCE_S)
        if not frames:
            raise TimeoutError(f"{pair.name} received nothing for {PATIENCE_S} s")
        count -= sum(frame.id == identifier for frame in frames)


def _echo(vehicle: str, bench: str, number: int) -> None:
    with HubBus(vehicle, role="member", name="echo") as bus:
        bus.send_frames([CanFrame(READY_ID, b"")])
        while True:
            frames = bus.recv_frames(PATIENCE_S)
            if not frames or frames[0].id == STOP_ID:
                return
            bus.send_frames(frames)


def _drain(vehicle: str, bench: str, number: int) -> None:
    with HubBus(vehicle, role="member", name=f"drain{number}") as bus:
        bus.send_frames([CanFrame(READY_ID, b"")])
        _until(bus, STOP_ID, 1)
        bus.send_frames([CanFrame(READY_ID, b"")])


def _controller(vehicle: str, bench: str, number: int) -> None:
    pair = HubPair(vehicle, name="controller", stamps=True)
    answer = [CanFrame(ANSWER_ID, bytes(8))] * PHASE_FRAMES[1]
    pair.send([], [CanFrame(READY_ID, b"")])
    heard = 0
    while True:
        for frame in pair.receive(1, PATIENCE_S):
            if frame.id == STOP_ID:
                pair.close()
                return
            heard += frame.id == TICK_ID  # and not the tuner's READY
        if heard == TICK_FRAMES:
            heard, got = 0, 0
            while got < PHASE_FRAMES[0]:
                got += len(pair.receive(0, PATIENCE_S))
            pair.send(answer, [CanFrame(DONE_ID, bytes(8))])


def _tuner(vehicle: str, bench: str, number: int) -> None:
    with HubBus(bench, role="member", name="tuner", only=(STOP_ID,)) as bus:
        bus.send_frames([CanFrame(READY_ID, b"")])
        _until(bus, STOP_ID, 1)


PARTS = {"echo": _echo, "drain": _drain, "controller": _controller, "tuner": _tuner}

if __name__ == "__main__":
    PARTS[sys.argv[1]](sys.argv[2], sys.argv[3], int(sys.argv[4]))
