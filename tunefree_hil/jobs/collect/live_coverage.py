"""Coverage of a human driver's drives: counted from logs, or live from a bus, without sending."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError, PeerGone
from tunefree_hil.base.events import Event
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.dbc.codec import Codec, Snapshot
from tunefree_hil.bus.link import BusLink
from tunefree_hil.bus.open import LinkRequest, open_link, resolve_bus
from tunefree_hil.collect.cells import NO_CELL, classify_cell, make_target_cells
from tunefree_hil.collect.coverage import Coverage, coverage_map_lines
from tunefree_hil.collect.envelope import envelope_from_vehicle
from tunefree_hil.collect.features import describe_missing_reports, read_signals, signal_sources
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.jobs.collect.picture import draw_map
from tunefree_hil.jobs.collect.plan import MAX_VALUES, require_driven_cells
from tunefree_hil.jobs.preconditions import require_number
from tunefree_hil.jobs.run_folder import write_json
from tunefree_hil.learn.drives.read import read_drives
from tunefree_hil.nodes.exchange import can_key
from tunefree_hil.nodes.measurement_decoder import MISSING_S, MeasurementDecoder

LOOK_S = 0.2
TELL_S = 1.0
INTERRUPTED = 130
OVERFLOW = "rx_overflow"  # frames were lost: the current run of frames ends, the watch continues


class WatchOptions(NamedTuple):
    """Options of `collect --watch` and of counting logs."""

    vehicle: str
    bus: str
    session: str
    quota_s: float
    top_mps: float | None = None
    seconds: float | None = None
    out: Path | None = None


def make_coverage(vehicle: VehicleSpec, options: WatchOptions) -> Coverage:
    """Empty coverage for a human driver, with reverse where the vehicle allows it.

    Raises InputError for an option out of range, and for a speed limit that leaves no cell.
    """
    require_number("--quota-s", options.quota_s, maximum=MAX_VALUES["quota_s"])
    require_number("--top-mps", options.top_mps, maximum=MAX_VALUES["top_mps"])
    require_number("--seconds", options.seconds, maximum=MAX_VALUES["drive_s"])
    envelope = envelope_from_vehicle(vehicle)
    targets = make_target_cells(envelope, options.top_mps, reverse_mps=vehicle.limits.reverse_mps)
    require_driven_cells(targets, envelope, options.top_mps)
    return Coverage(vehicle, targets, options.quota_s, vehicle.tick_ms * 1e-3)


def count_logs(logs: Sequence[Path], options: WatchOptions) -> Iterator[Event]:
    """Count logs. The exit status is 0 even if cells are missing."""
    vehicle = load_vehicle(options.vehicle)
    coverage, codec = make_coverage(vehicle, options), Codec(vehicle)
    yield from (Event("warning", text) for text in describe_missing_reports(vehicle))
    for i, log in enumerate(logs):
        for drive in read_drives([log], codec):
            coverage.add(drive.get)
        data = {"label": "log", "done": i + 1, "total": len(logs)}
        yield Event("progress", f"{log}: {_state(coverage)}", data)
    yield from _end(coverage, options)


def watch(options: WatchOptions) -> Iterator[Event]:
    """Listen to a bus and count until all cells are full, the time is over or Ctrl-C. Never sends a frame."""
    vehicle = load_vehicle(options.vehicle)
    coverage, codec = make_coverage(vehicle, options), Codec(vehicle)
    choice = resolve_bus(options.bus, options.session)
    if choice.kind == "virtual":
        hint = "--bus tfhub --session NAME, or --bus socketcan:can0"
        raise InputError("a virtual bus works inside one process only", code="one_process", key="--bus", hint=hint)
    fd = any(message.fd for message in (*codec.telemetry, *codec.commands))
    link = open_link(choice, "vehicle", LinkRequest("watch", role="observer", fd=fd))
    stopped = {}
    try:
        yield Event("note", f"listening on {choice.vehicle_address}, without sending; the map shows what is missing")
        yield from (Event("warning", text) for text in describe_missing_reports(vehicle))
        yield from _listen(LiveCounter(vehicle, codec, coverage), link, options)
    except KeyboardInterrupt:  # the usual way to end; the result is shown
        stopped = {"exit": INTERRUPTED}
    finally:
        link.close()
    yield from _end(coverage, options, stopped)


class LiveCounter:
    """Counts the ticks of received frames."""

    def __init__(self, vehicle: VehicleSpec, codec: Codec, coverage: Coverage) -> None:
        self.codec, self.coverage = codec, coverage
        self._sources = signal_sources(vehicle)
        self._command_keys = {message.key for message in codec.commands}
        self._restart()

    def _restart(self) -> None:
        self._decoder = MeasurementDecoder(self.codec, self.coverage.dt_s)
        self._commands = Snapshot(self.codec)
        self._zero_s: float | None = None
        self._tick, self._waiting = 0, []
        self.coverage.counter.end_run()

    def pause(self) -> None:
        """End the current run after a loss of frames."""
        self.coverage.counter.end_run()

    def add_frames(self, frames: Sequence[CanFrame]) -> None:
        """Add frames in the order of the bus; their time stamps give the tick. A clock that jumps back restarts it."""
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
                self._count_ticks(tick)
            self._waiting.append(frame)

    def _count_ticks(self, tick: int) -> None:
        """Count the complete ticks before `tick`. A gap that is too long ends the run."""
        commands = self._command_keys
        self._decoder.receive(self._tick, [frame for frame in self._waiting if can_key(frame) not in commands])
        for frame in self._waiting:
            message = self.codec.by_id[can_key(frame)]
            if message.key in commands and message.fits(frame.data):
                self._commands.receive(message, frame.data)
        self._waiting = []
        elapsed = tick - self._tick
        cell = classify_cell(
            self.coverage.bands, read_signals(self._sources, self._decoder.measurement(), self._commands.command())
        )
        for _ in range(min(elapsed, round(MISSING_S / self.coverage.dt_s))):
            self.coverage.counter.count_frame(cell)
        if elapsed > round(MISSING_S / self.coverage.dt_s):
            self.coverage.counter.count_frame(NO_CELL)
        self._tick = tick


def _listen(counter: LiveCounter, link: BusLink, options: WatchOptions) -> Iterator[Event]:
    started = shown = time.monotonic()
    coverage = counter.coverage
    while coverage.counter.missing and (options.seconds is None or time.monotonic() - started < options.seconds):
        try:
            counter.add_frames(link.receive(LOOK_S))
        except PeerGone as error:
            yield Event("note", error.message)
        except BenchError as error:
            yield Event("warning", error.message)
            if error.code != OVERFLOW:
                return  # the link is lost
            counter.pause()
        if time.monotonic() - shown >= TELL_S:
            shown = time.monotonic()
            data = {
                "label": "cells",
                "done": coverage.full,
                "total": coverage.wanted,
                "block": coverage_map_lines(coverage),
            }
            yield Event("progress", _state(coverage), data)


def _end(coverage: Coverage, options: WatchOptions, more: Mapping[str, Any] | None = None) -> Iterator[Event]:
    figures = [_write(coverage, options.out)] if options.out is not None else []
    yield from (Event("line", line) for line in coverage_map_lines(coverage))
    missing = coverage.missing()
    sentence = f"{_state(coverage)}; missing: {'; '.join(missing[:4])}" if missing else _state(coverage)
    sentence += f" and {len(missing) - 4} more" if len(missing) > 4 else ""
    data: dict[str, Any] = {"sentence": sentence, "missing": missing, "figures": figures, "next": []}
    data |= {"cells_full": coverage.full, "cells_wanted": coverage.wanted, "cells": coverage.as_dict()["cells"]}
    data |= more or {}
    yield Event("result", sentence, data)


def _write(coverage: Coverage, out: Path) -> str:
    """Write coverage.json and the figure."""
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "coverage.json", coverage.as_dict())
    title = f"{coverage.vehicle.name}: {_state(coverage)}"
    return str(draw_map(out / "figures" / "coverage.png", coverage, title))


def _state(coverage: Coverage) -> str:
    return f"{coverage.full} of {coverage.wanted} cells full, {coverage.collected_s:.0f} of {coverage.needed_s:.0f} s"
