"""What a drive stays inside of besides the vehicle's limits: what the data of a model covered.

A model is held by what it was made from. Where a drive goes beyond that, it misses things for its form alone, and what
is asked about it is lost among them. The region ([valid] of model.toml) says how far the data went: a few moments of
them did, so nothing is planned beyond.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from tunefree_hil.collect.envelope import HARD_SHARE, LATERAL_SHARE, Envelope
from tunefree_hil.config.schema import ValidSpec, VehicleSpec

# About as fast as a car creeps by itself. Below it creep, stick and clutches are no car that a model describes, and a
# calibration has next to nothing of it: who drives from place to place is there for moments only
CREEPS_MPS = 3.0
SLOW_SHARE = 0.125  # of the speed limit, of what is slower than a road car: half of its slowest cells' upper end


class Bounds(NamedTuple):
    """What a drive is not to go beyond, within the vehicle's limits: pedals as duty over rest, the rest as there.

    slow_mps: the speed below which nothing is held and nothing begins.
    """

    slow_mps: float
    speed_mps: float
    lateral_mps2: float
    steer_rad: float
    accel_low_mps2: float
    accel_high_mps2: float
    throttle_frac: float
    brake_frac: float

    @property
    def is_drivable(self) -> bool:
        """Whether they leave anything to drive at all."""
        return min(self.lateral_mps2, self.steer_rad, -self.accel_low_mps2, *self[5:]) > 0.0


def bounds_of(vehicle: VehicleSpec, valid: ValidSpec) -> Bounds:
    """What a model's data covered, where that is less than the vehicle's limits; to either side as far as to one."""
    limits, rest = vehicle.limits, vehicle.nominal.rest_pedal_frac
    brake, throttle = valid.pedals or (-math.inf, math.inf)  # duty, rest and all: the brake's negative
    slowing, quickening = valid.accel_mps2 or (-math.inf, math.inf)
    return Bounds(
        min(CREEPS_MPS, SLOW_SHARE * limits.speed_mps),
        min(limits.speed_mps, valid.speed_mps[1] if valid.speed_mps else math.inf),
        min(limits.lateral_accel_mps2, _reach(valid.lateral_accel_mps2)),
        min(limits.steer_rad, _reach(valid.steer_rad)),
        max(limits.accel_mps2[0], min(slowing, 0.0)),
        min(limits.accel_mps2[1], max(quickening, 0.0)),
        min(limits.throttle_frac, max(throttle, rest)) - rest,
        min(limits.brake_frac, max(-brake, rest)) - rest,
    )


def _reach(ends: Sequence[float] | None) -> float:
    return max(map(abs, ends)) if ends else math.inf


def within(envelope: Envelope, bounds: Bounds) -> Envelope:
    """The part of an envelope that is inside of bounds. What the planner plans with a share of comes up to them."""
    rest = envelope.rest_frac
    low = max(envelope.accel_low_mps2, bounds.accel_low_mps2 / HARD_SHARE)
    high = min(envelope.accel_high_mps2, bounds.accel_high_mps2)
    return envelope._replace(
        lateral_mps2=min(envelope.lateral_mps2, bounds.lateral_mps2 / LATERAL_SHARE),
        steer_rad=min(envelope.steer_rad, bounds.steer_rad),
        accel_low_mps2=low,
        accel_high_mps2=high,
        throttle_most=min(1.0, bounds.throttle_frac / (envelope.throttle_frac - rest)),
        brake_most=min(1.0, bounds.brake_frac / (envelope.brake_frac - rest)),
        calm_mps2=bounds.accel_high_mps2,
        high_share=high / envelope.accel_high_mps2,
        low_share=low / envelope.accel_low_mps2,
    )
