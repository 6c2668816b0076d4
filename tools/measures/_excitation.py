"""Commands that tell dead time, lag, rate limit and dead band of a by-wire channel apart: steps, chirps, small sines.

A script in the controller's place, seeded; it looks at the speed only, to stay between a walk and a fast trot.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from tools.measures._in_process import InProcess
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.control.cascade import ControllerInput, Decision
from tunefree_hil.nodes.controller import Assignment

SLOW_MPS, FAST_MPS = 2.0, 12.0
SECTION_S, STEP_S = 6.0, 0.8
KINDS = ("steps", "chirp", "small about rest", "small about an offset")
SIDE_MPS2 = 2.5  # what large steering steps may ask for


class Excitation(NamedTuple):
    """Whose channels, and by which seed."""

    vehicle: VehicleSpec
    seed: int

    def steer(self, time_s: float, speed_mps: float) -> float:
        """Steering wheel [rad]."""
        nominal, limits = self.vehicle.nominal, self.vehicle.limits
        wheelbase_m, ratio = nominal.wheelbase_m or 3.0, nominal.steer_ratio or 16.0
        most = SIDE_MPS2 * wheelbase_m * ratio / max(speed_mps, SLOW_MPS) ** 2
        return min(most, 0.5 * limits.steer_rad) * self._signal(0, time_s)

    def pedals(self, time_s: float, braking: bool) -> tuple[float, float]:
        """Throttle and brake duty; one of them rests."""
        limits, rest = self.vehicle.limits, self.vehicle.nominal.rest_pedal_frac
        signal = 0.5 * (1.0 + self._signal(2 if braking else 1, time_s))
        if braking:
            return rest, rest + 0.45 * (limits.brake_frac - rest) * signal
        return rest + 0.5 * (limits.throttle_frac - rest) * signal, rest

    def _signal(self, channel: int, time_s: float) -> float:
        """A number between -1 and 1: each section another kind, with numbers of its own."""
        section = int(time_s / SECTION_S)
        chance = np.random.default_rng([self.seed, channel, section])
        kind, share = (section + channel) % len(KINDS), time_s % SECTION_S
        if KINDS[kind] == "steps":
            steps = chance.uniform(-1.0, 1.0, math.ceil(SECTION_S / STEP_S) + 1)
            return float(steps[int(share / STEP_S)])
        if KINDS[kind] == "chirp":
            return 0.5 * math.sin(2.0 * math.pi * (0.3 + 0.25 * share) * share)
        about = 0.0 if KINDS[kind].endswith("rest") else float(chance.uniform(-0.6, 0.6))
        middle = about if channel == 0 or about else -0.9  # a pedal's rest is at its end
        return middle + 0.08 * math.sin(2.0 * math.pi * float(chance.uniform(0.5, 2.0)) * share)


def excited(process: InProcess, excitation: Excitation) -> None:
    """From now on the drives of `process` are commanded by the excitation."""
    assign = process.controller.assign

    def scripted(scenario: bytes, parameters: Any) -> Assignment:
        return assign(scenario, parameters)._replace(block=_block(excitation))

    process.controller.assign = scripted


def _block(excitation: Excitation) -> Block:
    """Block ControllerInput -> Decision."""

    def init(params: Any, dt_s: float) -> bool:
        return False

    def step(params: Any, braked: bool, x: ControllerInput, dt_s: float) -> tuple[bool, Decision]:
        time_s, speed = x.tick * dt_s, x.measurement.ins.speed_mps
        braking = speed > FAST_MPS or (braked and speed > SLOW_MPS)
        throttle, brake = excitation.pedals(time_s, braking)
        steer = excitation.steer(time_s, speed)
        command = Command(throttle, brake, steer, GEAR_DRIVE, NAN, NAN)
        return braking, Decision(command, Tracking(), steer, 0.0, 0.0, 0.0)

    return Block(init, step, 0.0)
