"""Bounds of a drive from the validity region of a model ([valid] of model.toml), within the vehicle's limits.

Outside the range of its data a model has errors of structure, which would hide the differences that a drive is to
show. So a drive is planned inside that range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from tunefree_hil.collect.envelope import HARD_SHARE, LATERAL_SHARE, Envelope
from tunefree_hil.config.schema import ValidSpec, VehicleSpec

# About the creep speed of a car. Below it, creep, stiction and clutches act, which the models do not describe and
# calibration data hardly contain.
CREEP_SPEED_MPS = 3.0
SLOW_SHARE = 0.125  # of the speed limit, for slow vehicles: half of the upper edge of the slowest speed band


class DriveBounds(NamedTuple):
    """Limits of a drive, within the vehicle's limits; pedals as duty above rest.

    slow_mps: lowest speed that is held or from which a manoeuvre begins.
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
        """Whether the bounds leave room for any driving."""
        return min(self.lateral_mps2, self.steer_rad, -self.accel_low_mps2, *self[5:]) > 0.0


def bounds_from_valid_region(vehicle: VehicleSpec, valid: ValidSpec) -> DriveBounds:
    """Smaller of the vehicle's limits and the range of the model's data; symmetric where the data are not."""
    limits, rest = vehicle.limits, vehicle.nominal.rest_pedal_frac
    brake, throttle = valid.pedals or (-math.inf, math.inf)  # duty including rest; the brake's negative
    decel, accel = valid.accel_mps2 or (-math.inf, math.inf)
    return DriveBounds(
        min(CREEP_SPEED_MPS, SLOW_SHARE * limits.speed_mps),
        min(limits.speed_mps, valid.speed_mps[1] if valid.speed_mps else math.inf),
        min(limits.lateral_accel_mps2, _max_abs(valid.lateral_accel_mps2)),
        min(limits.steer_rad, _max_abs(valid.steer_rad)),
        max(limits.accel_mps2[0], min(decel, 0.0)),
        min(limits.accel_mps2[1], max(accel, 0.0)),
        min(limits.throttle_frac, max(throttle, rest)) - rest,
        min(limits.brake_frac, max(-brake, rest)) - rest,
    )


def _max_abs(ends: Sequence[float] | None) -> float:
    return max(map(abs, ends)) if ends else math.inf


def limit_envelope(envelope: Envelope, bounds: DriveBounds) -> Envelope:
    """Reduce an envelope to bounds. Limits of which the planner uses a share are scaled so that the share fits."""
    rest = envelope.rest_frac
    low = max(envelope.accel_low_mps2, bounds.accel_low_mps2 / HARD_SHARE)
    high = min(envelope.accel_high_mps2, bounds.accel_high_mps2)
    return envelope._replace(
        lateral_mps2=min(envelope.lateral_mps2, bounds.lateral_mps2 / LATERAL_SHARE),
        steer_rad=min(envelope.steer_rad, bounds.steer_rad),
        accel_low_mps2=low,
        accel_high_mps2=high,
        max_throttle_push=min(1.0, bounds.throttle_frac / (envelope.throttle_frac - rest)),
        max_brake_push=min(1.0, bounds.brake_frac / (envelope.brake_frac - rest)),
        throttle_release_mps2=bounds.accel_high_mps2,
        accel_share=high / envelope.accel_high_mps2,
        decel_share=low / envelope.accel_low_mps2,
    )
