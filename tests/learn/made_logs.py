"""Logs made by a small kinematic car of a vehicle folder, in which a test can plant one thing that is wrong.

Speeds up, coasts and brakes in turn while it weaves; by-wire is enabled; actuators answer through a lag; noise on every
report. Enough for what reads, splits and checks logs; nothing is learned from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests import other_vehicle
from tunefree_hil.base.records import GEAR_DRIVE, WHEEL_FIELDS, Command, Ins, Report
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.message_map import COMMAND, MessageMap
from tunefree_hil.bus.formats.rows import FD, Row
from tunefree_hil.bus.recording.frame_writer import FrameWriter
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.episode.candump import write_candump
from tunefree_hil.learn.checks.drive_checks import LogProblem, check_drives
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.drives.read import read_drives

DT_S, SECONDS = 0.01, 30.0
MKZ, VAN = "mkz_bywire", other_vehicle.NAME
SOURCES = (("report", ""), ("report", "command_"), ("command", ""))
PEDALS = [f"{group}.{pedal}_{what}frac" for pedal in ("throttle", "brake") for group, what in SOURCES]
Records = dict[str, Any]
Change = Callable[[int, Records], Records]


class Car(NamedTuple):
    """A vehicle folder, read."""

    spec: VehicleSpec
    codec: Codec


@cache
def car(vehicle: str) -> Car:
    """By its name in dbc/."""
    spec = load_vehicle(vehicle)
    return Car(spec, Codec(spec))


@cache
def motion(vehicle: str, seconds: float, seed: int, speed_mps: float, ratio: float) -> tuple[Records, ...]:
    """The records of each tick, without noise on commands. ratio: the true steering ratio by the folder's."""
    nominal, limits = car(vehicle).spec.nominal, car(vehicle).spec.limits
    chance = np.random.default_rng(seed)
    rest, length_m = nominal.rest_pedal_frac, nominal.wheelbase_m or 1.0
    steer_ratio, radius_m = ratio * (nominal.steer_ratio or 1.0), nominal.wheel_radius_m or 0.3
    x = y = heading = speed = 0.0
    throttle = brake = steer = 0.0
    phase, amplitude = float(chance.uniform(0.0, 6.0)), float(chance.uniform(0.25, 0.35)) * limits.steer_rad
    rows = []
    for k in range(round(seconds / DT_S)):
        t = k * DT_S
        at = (t + phase) % 16.0
        push = 0.12 + 0.05 * math.sin(1.3 * t) if at < 8.0 and speed < speed_mps else 0.0
        stop = 0.08 + 0.04 * math.sin(0.9 * t) if 10.0 <= at < 13.0 else 0.0
        turn = amplitude * math.sin(0.5 * t + phase) / (1.0 + 0.02 * speed * speed)
        throttle += (push - throttle) * DT_S / 0.1
        brake += (stop - brake) * DT_S / 0.1
        steer += (turn - steer) * DT_S / 0.15
        accel = 12.0 * throttle - 30.0 * brake - (0.05 + 0.02 * speed if speed > 0.0 else 0.0)
        accel = max(accel, -speed / DT_S)
        yaw_rate = speed * math.tan(steer / steer_ratio) / length_m
        noise = chance.normal(size=len(Report._fields) + len(Ins._fields)).tolist()
        values = dict.fromkeys(Report._fields, math.nan) | {
            "throttle_input_frac": rest,
            "throttle_command_frac": rest + push,
            "throttle_frac": rest + throttle + 0.0005 * noise[0],
            "brake_input_frac": rest,
            "brake_command_frac": rest + stop,
            "brake_frac": rest + brake + 0.0005 * noise[1],
            "steer_command_rad": turn,
            "steer_rad": steer + 0.002 * noise[2],
            "steer_torque_nm": 0.1 * noise[3],
            "speed_mps": max(0.0, speed + 0.015 * noise[4]),
            "accel_mps2": accel + 0.05 * noise[5],
            "lateral_accel_mps2": speed * yaw_rate + 0.05 * noise[6],
            "yaw_rate_radps": yaw_rate + 0.0015 * noise[7],
            "gear": GEAR_DRIVE,
        }
        wheels = {name: speed / radius_m + 0.03 * noise[8 + i] for i, name in enumerate(WHEEL_FIELDS)}
        fix = (x + 0.01 * noise[12], y + 0.01 * noise[13], heading, speed + 0.01 * noise[14], accel, yaw_rate)
        command = Command(rest + push, rest + stop, turn, GEAR_DRIVE)
        rows.append({"report": Report(**(values | wheels)), "ins": Ins(*fix), "command": command})
        x += speed * math.cos(heading) * DT_S
        y += speed * math.sin(heading) * DT_S
        heading = (heading + yaw_rate * DT_S + math.pi) % (2.0 * math.pi) - math.pi
        speed = max(0.0, speed + accel * DT_S)
    return tuple(rows)


def rows_of(
    vehicle: str,
    seconds: float = 40.0,
    *,
    seed: int = 1,
    speed_mps: float = 12.0,
    ratio: float = 1.0,
    zero_s: float = 0.0,
    change: Change | None = None,
    only: Collection[str] = (),
) -> list[Row]:
    """The frames of a drive. change(k, records) -> what goes onto the wire instead. only: of these messages."""
    codec, records = car(vehicle).codec, motion(vehicle, seconds, seed, speed_mps, ratio)
    writer, rows = FrameWriter(codec), []
    messages = [one for one in (*codec.telemetry, *codec.commands) if not only or one.name in only]
    for k, some in enumerate(records):
        some = some if change is None else change(k, some)
        stamp_s = zero_s + k * DT_S
        for message in messages:
            if k % message.period_ticks == 0:
                frame = writer.write(message, some, _signals(message), stamp_s)
                rows.append(Row(round(stamp_s, 6), "can0", message.key, frame.data, FD if frame.fd else 0))
    return rows


def planted(vehicle: str, good: Sequence[Row], change: Change, names: Collection[str]) -> list[Row]:
    """The log `good`, but for the frames that carry one of these fields: those say what `change` makes of it."""
    codec, seconds = car(vehicle).codec, good[-1].time_s + DT_S
    of = [one for one in codec.by_name.values() if any(f"{field.group}.{field.name}" in names for field in one.fields)]
    made = rows_of(vehicle, round(seconds, 2), change=change, only=[one.name for one in of])
    instead = {one.key: iter([row for row in made if row.can_id == one.key]) for one in of}
    return [next(instead[row.can_id]) if row.can_id in instead else row for row in good]


def write_log(path: Path, rows: Sequence[Row]) -> Path:
    """As candump text."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_candump(path, rows)
    return path


def _signals(message: MessageMap) -> dict[str, float]:
    """By-wire is enabled, and says so."""
    if message.kind == COMMAND:
        return {message.enable: 1.0} if message.enable else {}
    return {state.signal: state.active for state in message.states if state.condition == "enabled"}


def with_report(change: Callable[[int, Report], Report]) -> Change:
    """A Change of reports only."""
    return lambda k, records: records | {"report": change(k, records["report"])}


def refusals(problems: list[LogProblem]) -> dict[str, LogProblem]:
    """What forbids learning, by its code."""
    return {one.code: one for one in problems if one.severity == "refuse"}


def drives_of(folder: Path, vehicle: str, *logs: Sequence[Row]) -> list[Drive]:
    """Logs written as log0.log, log1.log, ... and read."""
    paths = [write_log(folder / f"log{i}.log", rows) for i, rows in enumerate(logs)]
    return read_drives(paths, car(vehicle).codec)


def checked(folder: Path, vehicle: str, *logs: Sequence[Row]) -> list[LogProblem]:
    """What check_drives says of them."""
    return check_drives(drives_of(folder, vehicle, *logs), car(vehicle).spec)


@cache
def good(vehicle: str, seed: int = 1) -> tuple[Row, ...]:
    """A log with which nothing is wrong, of SECONDS."""
    return tuple(rows_of(vehicle, SECONDS, seed=seed))


def negated(name: str) -> Change:
    """A report field with its sign turned."""
    return with_report(lambda k, report: report._replace(**{name: -getattr(report, name)}))


def scaled(name: str, by: float) -> Change:
    """A report field times `by`."""
    return with_report(lambda k, report: report._replace(**{name: by * getattr(report, name)}))
