"""Drives of cars whose truth is known: the nominal car with other actuators and constants, through a rough wire."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from tunefree_hil.base.course import Start
from tunefree_hil.base.records import GEAR_DRIVE, NAN, WHEEL_FIELDS, Command, Disturbance
from tunefree_hil.learn.actuators.samples import ActuatorSamples, ChannelSamples
from tunefree_hil.learn.drives.drive import Drive, DrivePart
from tunefree_hil.plant.actuation.actuators import ActuatorParams, init_actuator, step_actuator
from tunefree_hil.plant.ports import Effects
from tunefree_hil.plant.single_track import PLANT
from tunefree_hil.plant.types import BodyInput, Driver
from tunefree_hil.plant.vehicle import assemble, first_output, for_episode

DT_S, REST = 0.01, 0.15
LATE = 3  # ticks from a command on the wire to its echo
SLOW = ("throttle_frac", "throttle_command_frac", "brake_frac", "brake_command_frac")  # every 20 ms
NOISE = {"speed_mps": 0.01, "yaw_rate_radps": 0.001, "heading_rad": 0.0005, "x_m": 0.005, "y_m": 0.005,
         "steer_rad": 0.001, "throttle_frac": 0.0003, "brake_frac": 0.0003, "lateral_accel_mps2": 0.03,
         "accel_mps2": 0.03}  # fmt: skip
QUANTUM = {"steer_rad": 0.0017, "throttle_frac": 1.0 / 65535, "brake_frac": 1.0 / 65535, "speed_mps": 0.01 / 3.6}
CHANNELS = {
    "throttle": ActuatorParams(dead_time_s=0.04, lag_s=0.05, rest=REST, initial=REST),
    "brake": ActuatorParams(dead_time_s=0.025, lag_s=0.08, rest=REST, initial=REST),
    "steer": ActuatorParams(dead_time_s=0.115, lag_s=0.09, rate_limit=7.0),
}
Script = Callable[[float], Command]


def excitation(seed: int = 1) -> Script:
    """Steps, sines and chirps on all channels, pedals in turn, seeded: a car that stays between 0 and 20 m/s."""
    chance = np.random.default_rng(seed)
    steps = chance.uniform(-1.0, 1.0, 2000)
    pushes = chance.uniform(0.0, 1.0, 2000)

    def script(time_s: float) -> Command:
        phase = time_s % 20.0
        hold = int(time_s / 1.3)
        if phase < 8.0:
            steer = 1.6 * steps[hold]
        elif phase < 14.0:
            steer = 0.15 * math.sin(2.0 * math.pi * (0.2 + 0.15 * (phase - 8.0)) * (phase - 8.0))
        else:
            steer = 0.05 * math.sin(2.0 * math.pi * 0.7 * phase) + 0.2
        throttle = brake = REST
        pull = time_s % 13.0
        if pull < 8.0:
            throttle = REST + 0.02 + 0.3 * pushes[int(time_s / 0.9)] * (1.0 if pull < 6.0 else 0.15)
        elif pull > 8.5:
            brake = REST + 0.01 + 0.14 * pushes[int(time_s / 0.7)] * (1.0 if pull < 11.5 else 0.3)
        return Command(throttle, brake, steer, GEAR_DRIVE, NAN, NAN)

    return script


def made_drive(
    seconds: float,
    *,
    seed: int = 1,
    params: Mapping[str, float] | None = None,
    channels: Mapping[str, ActuatorParams] | None = None,
    effects: Effects = (),
    script: Script | None = None,
    speed_mps: float = 3.0,
    grade_rad: float = 0.0,
    name: str = "made",
) -> Drive:
    """A drive as read_drives gives it: commands of the wire, echoes, outputs, motion; noise and rounding on reports."""
    body = assemble(PLANT, params or {}, channels or CHANNELS, effects=effects, rest_frac=(REST, REST), dt_s=DT_S)
    body = for_episode(body, Start(speed_mps=speed_mps))
    ticks = round(seconds / DT_S)
    script = script or excitation(seed)
    rows: list[dict[str, float]] = []
    state, _ = first_output(body, DT_S)
    for k in range(ticks):
        asked = script(k * DT_S)
        x = BodyInput(asked, Driver(), Disturbance(grade_rad=grade_rad))
        state, out = body.block.step(body.block.params, state, x, DT_S)
        report = {f"report.{key}": value for key, value in out.measurement.report._asdict().items()}
        rows.append(report | {f"ins.{key}": value for key, value in out.measurement.ins._asdict().items()})
    fields = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    for field in ("throttle_frac", "brake_frac", "steer_rad"):
        wire = np.array([getattr(script((k + LATE) * DT_S), field) for k in range(ticks)])
        fields[f"command.{field}"] = rounded(wire, QUANTUM[field])
    return as_drive(fields, seed, name)


def as_drive(fields: dict[str, np.ndarray], seed: int, name: str = "made") -> Drive:
    """Noise, rounding, periods."""
    chance = np.random.default_rng([seed, 99])
    left_out = {f"report.{wheel}" for wheel in WHEEL_FIELDS} | {"report.gear"}
    kept: dict[str, np.ndarray] = {}
    fresh: dict[str, np.ndarray] = {}
    for key, values in fields.items():
        group, _, bare = key.partition(".")
        if key in left_out or not np.isfinite(values).all():
            continue
        values = values.copy()
        if group != "command" and "command" not in bare:
            values += NOISE.get(bare, 0.0) * chance.standard_normal(len(values))
        quantum = QUANTUM.get(bare.replace("_command", ""), 0.0)
        values = rounded(values, quantum)
        came = np.ones(len(values), dtype=bool)
        if group == "report" and bare in SLOW:
            came[1::2] = False
            values[1::2] = values[: len(values) // 2 * 2 : 2]
        kept[key], fresh[key] = values, came
    return Drive(name, f"sha256:{seed:064x}", DT_S, kept, fresh, np.ones(len(values), dtype=bool))


def rounded(values: np.ndarray, quantum: float) -> np.ndarray:
    return np.round(values / quantum) * quantum if quantum else values


def whole(drive: Drive) -> DrivePart:
    return DrivePart(drive, 0, drive.n_rows)


def made_pairs(
    params: ActuatorParams, seconds: float, seed: int, *, span: float = 1.0, noise: float = 0.0, quantum: float = 0.0
) -> ChannelSamples:
    """One channel alone: steps, small sines about rest and about an offset, through the actuator and a rough report."""
    chance = np.random.default_rng([seed, 7])
    n = round(seconds / DT_S)
    time_s = np.arange(n) * DT_S
    held = np.repeat(chance.uniform(-1.0, 1.0, n // 60 + 1), 60)[:n]
    small = 0.06 * np.sin(2.0 * np.pi * (0.3 + 0.1 * (time_s % 10.0)) * time_s)
    kind = (time_s // 6.0).astype(int) % 3
    command = rounded(params.rest + span * np.where(kind == 0, held, np.where(kind == 1, small, 0.4 + small)), quantum)
    state: Any = init_actuator(params._replace(initial=float(command[0])), DT_S)
    output = np.empty(n)
    for k in range(n):
        state, output[k] = step_actuator(params, state, float(command[k]), DT_S)
    output = rounded(output + noise * chance.standard_normal(n), quantum)
    counts = np.ones(n, dtype=bool)
    counts[:100] = False
    return ChannelSamples("steer", (ActuatorSamples(command, output, counts, DT_S),), "made")
