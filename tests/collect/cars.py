"""Cars with drawn constants for the planner to drive in one process: nobody's physics, only awkward ones."""

from __future__ import annotations

import math
from collections import deque
from random import Random
from typing import NamedTuple

from tunefree_hil.base.kernel import Block
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import GEAR_DRIVE, Command, Ins, Measurement, Report
from tunefree_hil.collect.envelope import Envelope
from tunefree_hil.collect.planner import ENDED, PlannerParams, make_planner
from tunefree_hil.control.cascade import ControllerInput

DT_S = 0.01


class Row(NamedTuple):
    """One tick of a drive: what was true, what was commanded, what the planner was at."""

    x_m: float
    y_m: float
    speed_mps: float
    lateral_mps2: float
    steer_rad: float
    throttle_frac: float
    brake_frac: float
    command: Command
    mode: int
    cell: int


class Car:
    """A bicycle that understeers by a drawn amount, with drawn pedals, dead times, lags and noise."""

    def __init__(self, envelope: Envelope, seed: int) -> None:
        chance = Random(seed)
        self.envelope, self.chance = envelope, chance
        self.x_m = self.y_m = self.heading_rad = self.speed_mps = self.yaw_radps = self.accel_mps2 = 0.0
        self.steer_rad = 0.0
        self.throttle_frac = self.brake_frac = envelope.rest_frac
        self.pull_mps2 = chance.uniform(1.6, 3.2) * envelope.accel_high_mps2  # full throttle
        self.power = chance.uniform(6.0, 12.0)  # m/s from which power limits it
        self.bite_mps2 = chance.uniform(1.2, 2.0) * -envelope.accel_low_mps2  # full brake
        self.play = chance.uniform(0.0, 0.12)  # of the brake's way
        self.creep_mps2 = chance.uniform(0.0, 0.5)
        self.drag = chance.uniform(0.0004, 0.0008)
        self.rolling_mps2 = chance.uniform(0.08, 0.25)
        self.slip = chance.uniform(0.0, 0.004)  # understeer, s2/m2
        self.ratio = envelope.steer_ratio * chance.uniform(0.93, 1.07)
        self.steer_lag_s, self.pedal_lag_s = chance.uniform(0.03, 0.12), chance.uniform(0.03, 0.2)
        dead = [round(chance.uniform(0.0, most) / DT_S) for most in (0.2, 0.1)]
        self.wheel_line = deque([0.0] * (dead[0] + 1))
        self.pedal_line = deque([(envelope.rest_frac, envelope.rest_frac)] * (dead[1] + 1))

    def measure(self) -> Measurement:
        """What the frames would say, noise and all."""
        noise = self.chance.gauss
        speed = max(0.0, self.speed_mps + noise(0.0, 0.012))
        report = Report(
            throttle_frac=self.throttle_frac,
            brake_frac=self.brake_frac,
            steer_rad=self.steer_rad + noise(0.0, 0.001),
            speed_mps=speed,
            gear=GEAR_DRIVE,
        )
        pose = (self.x_m + noise(0.0, 0.01), self.y_m + noise(0.0, 0.01), self.heading_rad + noise(0.0, 0.0007))
        return Measurement(report, Ins(*pose, speed, self.accel_mps2, self.yaw_radps + noise(0.0, 0.0007)))

    def step(self, command: Command) -> None:
        """One tick."""
        e = self.envelope
        self.wheel_line.append(command.steer_rad)
        self.pedal_line.append((command.throttle_frac, command.brake_frac))
        reach = e.steer_rate_radps * DT_S
        way = (self.wheel_line.popleft() - self.steer_rad) * DT_S / self.steer_lag_s
        self.steer_rad += clamp(way, -reach, reach)
        throttle, brake = self.pedal_line.popleft()
        share = DT_S / (DT_S + self.pedal_lag_s)
        self.throttle_frac += share * (throttle - self.throttle_frac)
        self.brake_frac += share * (brake - self.brake_frac)
        self._roll()

    def _roll(self) -> None:
        e, v = self.envelope, self.speed_mps
        pushed = (self.throttle_frac - e.rest_frac) / (e.throttle_frac - e.rest_frac)
        braked = max(0.0, (self.brake_frac - e.rest_frac) / (e.brake_frac - e.rest_frac) - self.play)
        pull = self.pull_mps2 * (1.0 - math.exp(-3.0 * pushed)) * min(1.0, self.power / max(v, 0.1))
        creep = self.creep_mps2 * max(0.0, 1.0 - v / 2.0) if braked == 0.0 else 0.0
        against = self.rolling_mps2 + self.drag * v * v + self.bite_mps2 * braked
        rate = pull + creep - against
        if v <= 0.0 and rate < 0.0:
            rate = 0.0
        self.accel_mps2, self.speed_mps = rate, max(0.0, v + rate * DT_S)
        curvature = math.tan(self.steer_rad / self.ratio) / (e.wheelbase_m * (1.0 + self.slip * v * v))
        self.yaw_radps = self.speed_mps * curvature
        middle = self.heading_rad + 0.5 * DT_S * self.yaw_radps
        self.heading_rad += DT_S * self.yaw_radps
        self.x_m += DT_S * self.speed_mps * math.cos(middle)
        self.y_m += DT_S * self.speed_mps * math.sin(middle)


def drive(params: PlannerParams, car: Car, most_s: float = 180.0) -> tuple[list[Row], list[int], bool]:
    """One drive of the planner: (rows, frames by cell as it counted them, whether it ended by itself)."""
    block: Block = make_planner(params)
    state = block.init(block.params, DT_S)
    rows: list[Row] = []
    for k in range(round(most_s / DT_S)):
        state, answer = block.step(block.params, state, ControllerInput(k, car.measure()), DT_S)
        lateral = car.speed_mps * car.yaw_radps
        now = (car.x_m, car.y_m, car.speed_mps, lateral, car.steer_rad, car.throttle_frac, car.brake_frac)
        rows.append(Row(*now, answer.command, answer.mode, answer.cell))
        if answer.error_code == ENDED:
            return rows, state.counter.have, True
        car.step(answer.command)
    return rows, state.counter.have, False
