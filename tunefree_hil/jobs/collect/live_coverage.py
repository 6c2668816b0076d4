"""Coverage of drives that a person drives: counted from logs, or live from a bus that is only listened to."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError, PeerGone
from tunefree_hil.base.events import Event
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.dbc.codec import Codec, Snapshot
from tunefree_hil.bus.link import Link
from tunefree_hil.bus.open import open_link, resolve_bus
from tunefree_hil.collect.cells import NONE, cell_of, targets_of
from tunefree_hil.collect.coverage import Coverage, map_lines
from tunefree_hil.collect.envelope import envelope_of
from tunefree_hil.collect.features import eyes_of, lacking, look
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.jobs.collect.picture import draw_map
from tunefree_hil.jobs.collect.plan import MOST, some_driven
from tunefree_hil.jobs.preconditions import require_number
from tunefree_hil.jobs.run_folder import write_json
from tunefree_hil.learn.drives.read import read_drives
from tunefree_hil.nodes.exchange import can_key
from tunefree_hil.nodes.measurement_decoder import MISSING_S, Hearing

LOOK_S = 0.2
TELL_S = 1.0
INTERRUPTED = 130
OVERFLOW = "rx_overflow"  # frames were lost: a run of frames ends there, the watch goes on


class Wish(NamedTuple):
    """The command line of a watch."""

    vehicle: str
    bus: str
    session: str
    quota_s: float
    top_mps: float | None
    seconds: float | None
    out: Path | None


def coverage_for(vehicle: VehicleSpec, wish: Wish) -> Coverage:
    """Empty coverage of a person's driving: backwards too, where the vehicle does that.

    Raises InputError for a number of the command line that is none, and for a speed at which no cell is left.
    """
    require_number("--quota-s", wish.quota_s, most=MOST["quota_s"])
    require_number("--top-mps", wish.top_mps, most=MOST["top_mps"])
    require_number("--seconds", wish.seconds, most=MOST["drive_s"])
    envelope = envelope_of(vehicle)
    targets = targets_of(envelope, wish.top_mps, reverse_mps=vehicle.limits.reverse_mps)
    some_driven(targets, envelope, wish.top_mps)
    return Coverage(vehicle, targets, wish.quota_s, vehicle.tick_ms * 1e-3)


def from_logs(logs: Sequence[Path], wish: Wish) -> Iterator[Event]:
    """Count logs. Exit status 0 whatever is missing: that is what was asked for."""
    vehicle = load_vehicle(wish.vehicle)
    coverage, codec = coverage_for(vehicle, wish), Codec(vehicle)
    yield from (Event("warning", words) for words in lacking(vehicle))
    for i, log in enumerate(logs):
        for drive in read_drives([log], codec):
            coverage.add(drive.get)
        data = {"label": "log", "done": i + 1, "total": len(logs)}
        yield Event("progress", f"{log}: {_state(coverage)}", data)
    yield from _end(coverage, wish)


def watch(wish: Wish) -> Iterator[Event]:
    """Listen to a bus and count, until all is full, the time is over or Ctrl-C. It never sends a frame."""
    vehicle = load_vehicle(wish.vehicle)
    coverage, codec = coverage_for(vehicle, wish), Codec(vehicle)
    choice = resolve_bus(wish.bus, wish.session)
    if choice.kind == "virtual":
        hint = "--bus tfhub --session NAME, or --bus socketcan:can0"
        raise InputError("a virtual bus does not leave its process", code="one_process", key="--bus", hint=hint)
    fd = any(message.fd for message in (*codec.telemetry, *codec.commands))
    link = open_link(choice, "vehicle", name="watch", role="observer", fd=fd)
    stopped = {}
    try:
        yield Event("note", f"listening only, on {choice.vehicle_address}; drive, the map says what is missing")
        yield from (Event("warning", words) for words in lacking(vehicle))
        yield from _listen(Ears(vehicle, codec, coverage), link, wish)
    except KeyboardInterrupt:  # how a person ends it; what was seen is shown all the same
        stopped = {"exit": INTERRUPTED}
    finally:
        link.close()
    yield from _end(coverage, wish, stopped)


class Ears:
    """Frames as they come -> ticks of a recording -> counts."""

    def __init__(self, vehicle: VehicleSpec, codec: Codec, coverage: Coverage) -> None:
        self.codec, self.coverage = codec, coverage
        self._eyes = eyes_of(vehicle)
        self._command_keys = {message.key for message in codec.commands}
        self._restart()

    def _restart(self) -> None:
        self._hearing = Hearing(self.codec, self.coverage.dt_s)
        self._commands = Snapshot(self.codec)
        self._zero_s: float | None = None
        self._tick, self._waiting = 0, []
        self.coverage.counter.pause()

    def pause(self) -> None:
        """Frames were lost."""
        self.coverage.counter.pause()

    def hear(self, frames: Sequence[CanFrame]) -> None:
        """Take in frames in the order of the bus; their stamps say the tick. A clock that goes back begins anew."""
        for frame in frames:
            if can_key(frame) not in self.codec.by_id:
                continue
            if self._zero_s is None:
                self._zero_s = frame.time_s
            tick = round((frame.time_s - self._zero_s) / self.coverage.dt_s)
            if tick < self._tick - 1:
                self._restart()
                self._zero_s, tick = frame.time_s, 0
            if tick > self._tick:
                self._close(tick)
            self._waiting.append(frame)

    def _close(self, tick: int) -> None:
        """The ticks before `tick` are complete: see them. A silence that is too long breaks the run."""
        commands = self._command_keys
        self._hearing.hear(self._tick, [frame for frame in self._waiting if can_key(frame) not in commands])
        for frame in self._waiting:
            message = self.codec.by_id[can_key(frame)]
            if message.key in commands and self.codec.fits(message, frame.data):
                self._commands.hear(message, frame.data)
        self._waiting = []
        silent = tick - self._tick
        seen = cell_of(self.coverage.bands, look(self._eyes, self._hearing.measurement(), self._commands.command()))
        for _ in range(min(silent, round(MISSING_S / self.coverage.dt_s))):
            self.coverage.counter.see(seen)
        if silent > round(MISSING_S / self.coverage.dt_s):
            self.coverage.counter.see(NONE)
        self._tick = tick


def _listen(ears: Ears, link: Link, wish: Wish) -> Iterator[Event]:
    started = told = time.monotonic()
    coverage = ears.coverage
    while coverage.counter.missing and (wish.seconds is None or time.monotonic() - started < wish.seconds):
        try:
            ears.hear(link.receive(LOOK_S))
        except PeerGone as error:
            yield Event("note", error.message)
        except BenchError as error:
            yield Event("warning", error.message)
            if error.code != OVERFLOW:
                return  # there is nothing more to hear
            ears.pause()
        if time.monotonic() - told >= TELL_S:
            told = time.monotonic()
            data = {"label": "cells", "done": coverage.full, "total": coverage.wanted, "block": map_lines(coverage)}
            yield Event("progress", _state(coverage), data)


def _end(coverage: Coverage, wish: Wish, more: Mapping[str, Any] | None = None) -> Iterator[Event]:
    figures = [_write(coverage, wish.out)] if wish.out is not None else []
    yield from (Event("line", line) for line in map_lines(coverage))
    missing = coverage.missing()
    sentence = f"{_state(coverage)}; missing: {'; '.join(missing[:4])}" if missing else _state(coverage)
    sentence += f" and {len(missing) - 4} more" if len(missing) > 4 else ""
    data: dict[str, Any] = {"sentence": sentence, "missing": missing, "figures": figures, "next": []}
    data |= {"cells_full": coverage.full, "cells_wanted": coverage.wanted, "cells": coverage.as_dict()["cells"]}
    data |= more or {}
    yield Event("result", sentence, data)


def _write(coverage: Coverage, out: Path) -> str:
    """coverage.json and the picture."""
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "coverage.json", coverage.as_dict())
    title = f"{coverage.vehicle.name}: {_state(coverage)}"
    return str(draw_map(out / "figures" / "coverage.png", coverage, title))


def _state(coverage: Coverage) -> str:
    return f"{coverage.full} of {coverage.wanted} cells full, {coverage.had_s:.0f} of {coverage.needed_s:.0f} s"
