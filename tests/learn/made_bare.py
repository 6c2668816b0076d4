"""Drives of cars that report no actuator's output: only commands, and the motion."""

from __future__ import annotations

import math

import numpy as np

from tests.learn.made_drives import DT_S, LATE, NOISE, made_drive
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command, Disturbance
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.plant.actuation.acceleration_interface import linear
from tunefree_hil.plant.actuation.actuators import ActuatorParams
from tunefree_hil.plant.single_track import PLANT
from tunefree_hil.plant.types import BodyInput, Driver
from tunefree_hil.plant.vehicle import assemble, first_output, for_episode

BARE = ("command.", "report.speed_mps", "report.yaw_rate_radps")
ACCEL = ActuatorParams(dead_time_s=0.08, lag_s=0.25, gain=1.06)
MASS_KG = 1600.0


def bare_drive(seconds: float, seed: int = 1, **options: object) -> Drive:
    """The drive of made_drives.py without any report of an actuator, and without an INS."""
    drive = made_drive(seconds, seed=seed, **options)  # type: ignore[arg-type]
    fields = {name: one for name, one in drive.fields.items() if name.startswith(BARE)}
    return drive._replace(fields=fields, fresh={name: drive.fresh[name] for name in fields})


def asked(time_s: float) -> float:
    """Steps and waves of an acceleration, m/s2."""
    step = (0.9, -0.7, 0.0, 1.4, -1.6, 0.4)[int(time_s / 4.0) % 6]
    return step + 0.2 * math.sin(1.3 * time_s)


def accel_drive(seconds: float, seed: int = 1, accel: ActuatorParams = ACCEL) -> Drive:
    """A car that is asked for an acceleration; steering wheel, speed and wheels are reported, no yaw rate."""
    body = assemble(
        PLANT, linear(MASS_KG, 0.0) | {"mass_kg": MASS_KG}, {"accel": accel, "steer": ActuatorParams()},
        rest_frac=(0.0, 0.0), dt_s=DT_S,
    )  # fmt: skip
    body = for_episode(body, Start(speed_mps=12.0))
    state, _ = first_output(body, DT_S)
    ticks, rows = round(seconds / DT_S), []
    for k in range(ticks):
        time_s = k * DT_S
        command = Command(NAN, NAN, 0.5 * math.sin(0.4 * time_s), GEAR_DRIVE, asked(time_s), NAN)
        state, out = body.block.step(
            body.block.params, state, BodyInput(command, Driver(0.0, 0.0), Disturbance()), DT_S
        )
        rows.append(out.measurement.report)
    chance = np.random.default_rng([seed, 5])
    names = ("speed_mps", "steer_rad", "wheel_rl_radps", "wheel_rr_radps")
    fields = {
        f"report.{name}": np.array([getattr(row, name) for row in rows])
        + NOISE.get(name, 0.002) * chance.standard_normal(ticks)
        for name in names
    }
    fields["command.accel_mps2"] = np.array([asked((k + LATE) * DT_S) for k in range(ticks)])
    fresh = {name: np.ones(ticks, dtype=bool) for name in fields}
    return Drive("asked", f"sha256:{seed:064x}", DT_S, fields, fresh, np.ones(ticks, dtype=bool))
