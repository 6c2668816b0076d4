"""Sources of the signals that determine cells, with substitutes for missing reports; records of the planner."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.records import GROUPS, Command, Measurement
from tunefree_hil.collect import steering
from tunefree_hil.collect.area import DrivingArea, Pose
from tunefree_hil.collect.cells import NO_CELL, BandEdges, CellCounter, CellSignals, TargetCell, classify_cell
from tunefree_hil.collect.envelope import Envelope
from tunefree_hil.collect.gentle_driving import GentleState, GentleStretch
from tunefree_hil.collect.pedals import PedalState
from tunefree_hil.config.schema import VehicleSpec

Array = np.ndarray

# field of CellSignals -> record fields, best first
FIELD_CHOICES: dict[str, tuple[str, ...]] = {
    "gear": ("report.gear",),
    "speed_mps": ("report.speed_mps", "ins.speed_mps"),
    "steer_rad": ("report.steer_rad", "report.steer_command_rad", "command.steer_rad"),
    "throttle_frac": ("report.throttle_frac", "report.throttle_command_frac", "command.throttle_frac"),
    "brake_frac": ("report.brake_frac", "report.brake_command_frac", "command.brake_frac"),
}
MISSING_REPORT_EFFECTS = {
    "report.throttle_frac": "`calibrate` identifies the throttle's dead time and lag from the motion, less precisely",
    "report.brake_frac": "`calibrate` identifies the brake's dead time and lag from the motion, less precisely",
    "report.steer_rad": "`calibrate` identifies the steering's dead time and lag from the yaw rate, less precisely",
    "report.speed_mps": "cells are counted with the INS speed",
    "report.gear": "every frame counts as forward driving",
}


class SignalSources(NamedTuple):
    """For each field of CellSignals (record group, index in the record); group '' where there is no source."""

    gear: tuple[str, int]
    speed_mps: tuple[str, int]
    steer_rad: tuple[str, int]
    throttle_frac: tuple[str, int]
    brake_frac: tuple[str, int]


def choose_sources(known: Collection[str]) -> dict[str, str]:
    """field of CellSignals -> its record field, '' where none of `known` supplies it."""
    return {name: next((one for one in choices if one in known), "") for name, choices in FIELD_CHOICES.items()}


def mapped_fields(vehicle: VehicleSpec) -> list[str]:
    """The record fields that a vehicle folder maps: 'report.speed_mps', ..."""
    return [f"{group}.{name}" for group in GROUPS for name in getattr(vehicle, group)]


def signal_sources(vehicle: VehicleSpec) -> SignalSources:
    """Sources of the cell signals in a vehicle's records."""
    return SignalSources(*(_locate_field(source) for source in choose_sources(mapped_fields(vehicle)).values()))


def describe_missing_reports(vehicle: VehicleSpec) -> list[str]:
    """A text for each report that this vehicle does not send, with the consequence."""
    known = mapped_fields(vehicle)
    texts = [f"no [{name}]: {text}" for name, text in MISSING_REPORT_EFFECTS.items() if name not in known]
    if not choose_sources(known)["speed_mps"]:
        texts.append("no speed is reported: gentle driving is not possible")
    return texts


def read_signals(sources: SignalSources, measurement: Measurement, command: Command) -> CellSignals:
    """Signals of a tick; command: the last one sent."""
    records = {"report": measurement.report, "ins": measurement.ins, "command": command}
    return CellSignals(*(records[group][index] if group else math.nan for group, index in sources))


def count_recording(get: Callable[[str], Array | None], bands: BandEdges, counter: CellCounter) -> CellCounter:
    """Count a recording into `counter` as if it came tick by tick; get: its columns by name.

    A recording without speed, steering or pedals adds nothing.
    """
    columns = []
    for name, choices in FIELD_CHOICES.items():
        column = next((values for choice in choices if (values := get(choice)) is not None), None)
        if column is None and name != "gear":
            return counter
        columns.append(column)
    rows = max(len(column) for column in columns if column is not None)
    filled = [np.full(rows, math.nan) if column is None else column for column in columns]
    counter.end_run()
    _count_rows(zip(*(column.tolist() for column in filled), strict=True), bands, counter)
    counter.end_run()
    return counter


def _count_rows(rows: Iterable[tuple[float, ...]], bands: BandEdges, counter: CellCounter) -> None:
    for row in rows:
        counter.count_frame(classify_cell(bands, CellSignals._make(row)))


def _locate_field(source: str) -> tuple[str, int]:
    group, _, name = source.partition(".")
    return (group, GROUPS[group]._fields.index(name)) if source else ("", 0)


START, APPROACH, HOLD, TURN, STOP, STAND, GENTLE = range(7)


class PlannerParams(NamedTuple):
    """Parameters of a drive. have, need: frames by cell. stop_tick: the tick at which it begins to stop.

    area: None where it is centred on the first position. first_hold: number of the first hold, so that the drives
    differ in their excitation. stretches: gentle stretches, driven before the cells.
    """

    envelope: Envelope
    bands: BandEdges
    targets: tuple[TargetCell, ...]
    sources: SignalSources
    have: tuple[int, ...]
    need: tuple[int, ...]
    half_m: float
    area: DrivingArea | None
    stop_tick: int
    first_hold: int
    stretches: tuple[GentleStretch, ...] = ()


class PlannerState(NamedTuple):
    """State of the planner. mode_tick: tick at which the mode began. counter: owned by the state, changed in place."""

    counter: CellCounter
    area: DrivingArea | None
    command: Command
    mode: int = START
    mode_tick: int = 0
    cell: int = NO_CELL
    skipped_cell: int = NO_CELL
    hold_count: int = 0
    pedals: PedalState = PedalState()
    wheel: steering.WheelState = steering.WheelState()
    aim: tuple[float, float] = (0.0, 0.0)
    gentle: GentleState = GentleState()


class PlannerOutput(NamedTuple):
    """Command, and error_code ENDED when the drive has ended; mode and cell for observers."""

    command: Command
    error_code: float
    mode: int
    cell: int


class PlannerTick(NamedTuple):
    """Measured data of a tick. room_m: distance ahead to the inner border."""

    number: int
    dt_s: float
    signals: CellSignals
    pose: Pose
    room_m: float

    def since_s(self, tick: int) -> float:
        """Time since an earlier tick."""
        return (self.number - tick) * self.dt_s
