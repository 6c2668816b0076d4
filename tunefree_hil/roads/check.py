"""Where a made road asks for more than its limits allow.

The limits are narrower than those of episode/feasible.py in every quantity, and the signals are those of which a course
is built; the course itself, tens of times slower to build, is not needed for them.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np

from tunefree_hil.roads.draft import STEP_S, RoadDraft
from tunefree_hil.roads.limits import CRITERIA, GRAVITY_MPS2, RoadLimits, jerk_at_mps3

TOLERANCE = 1e-3  # of a limit: rounding of the written breakpoints


class RoadQuantity(Enum):
    """A quantity of a road that has a limit; the value is its name in a message, with the unit."""

    DURATION = "duration, s"
    SPEED = "speed, m/s"
    ACCEL = "acceleration with the slope's share, m/s2"
    DECEL = "deceleration with the slope's share, m/s2"
    JERK = "jerk along the road, m/s3"
    CURVATURE = "curvature (steering angle), 1/m"
    CURVATURE_RATE = "rate of curvature (steering rate), 1/m/s"
    LATERAL_ACCEL = "lateral acceleration with the bank's and the wind's share, m/s2"
    LATERAL_JERK = "lateral jerk, m/s3"
    GRIP = "acceleration in the plane for the road's friction, m/s2"


class LimitExcess(NamedTuple):
    """A quantity beyond its limit, at its worst point."""

    quantity: RoadQuantity
    value: float
    limit: float
    time_s: float


def find_excesses(draft: RoadDraft, limits: RoadLimits) -> list[LimitExcess]:
    """The quantities of a road that are beyond its limits, in the order of RoadQuantity. [] if none."""
    speed, curvature = draft.speed_mps, draft.curvature_1pm
    accel = np.diff(speed) / STEP_S
    middle_mps = 0.5 * (speed[1:] + speed[:-1])
    pull = accel + GRAVITY_MPS2 * np.sin(_middle(_or_flat(draft, draft.grade_rad, 0.0)))
    lateral = speed * speed * curvature
    held = lateral + _side_pull(draft)
    middle_held = middle_mps * middle_mps * 0.5 * (curvature[1:] + curvature[:-1]) + _middle(_side_pull(draft))
    grip = CRITERIA.max_grip_share * GRAVITY_MPS2 * _middle(_or_flat(draft, draft.friction_frac, 1.0))
    duration = np.full(1, (len(speed) - 1) * STEP_S)
    checks = (
        (RoadQuantity.DURATION, duration, CRITERIA.max_duration_s),
        (RoadQuantity.SPEED, speed, limits.speed_mps),
        (RoadQuantity.ACCEL, np.maximum(pull, 0.0), limits.accel_at_mps2(middle_mps)),
        (RoadQuantity.DECEL, np.maximum(-pull, 0.0), limits.decel_at_mps2(middle_mps)),
        (RoadQuantity.JERK, _mean_rate(accel), jerk_at_mps3(_window_most(middle_mps))),
        (RoadQuantity.CURVATURE, curvature, limits.curvature_1pm(speed)),
        (RoadQuantity.CURVATURE_RATE, np.diff(curvature) / STEP_S, limits.curvature_rate_1pmps(middle_mps)),
        (RoadQuantity.LATERAL_ACCEL, held, limits.lateral_accel_mps2),
        (RoadQuantity.LATERAL_JERK, _mean_rate(lateral), CRITERIA.max_lateral_jerk_mps3),
        (RoadQuantity.GRIP, np.hypot(pull, middle_held), grip),
    )
    return [excess for check in checks if (excess := _worst(*check)) is not None]


def excess_text(excess: LimitExcess) -> str:
    """The excess in words."""
    quantity, _, unit = excess.quantity.value.rpartition(", ")
    return f"{quantity} {excess.value:.3g} {unit} at t = {excess.time_s:.1f} s, the limit is {excess.limit:.3g} {unit}"


def _worst(quantity: RoadQuantity, values: np.ndarray, limit: float | np.ndarray) -> LimitExcess | None:
    bounds = np.broadcast_to(np.asarray(limit, dtype=float), values.shape)
    beyond = np.abs(values) - bounds * (1.0 + TOLERANCE)
    index = int(np.argmax(beyond))
    if beyond[index] <= 0.0:
        return None
    return LimitExcess(quantity, float(abs(values[index])), float(bounds[index]), index * STEP_S)


def _side_pull(draft: RoadDraft) -> np.ndarray:
    """Lateral acceleration, to the left, that the tyres give against bank and wind: what it takes to go straight on."""
    return GRAVITY_MPS2 * np.sin(_or_flat(draft, draft.bank_rad, 0.0)) - _or_flat(draft, draft.side_wind_mps2, 0.0)


def _or_flat(draft: RoadDraft, values: np.ndarray | None, otherwise: float) -> np.ndarray:
    return np.full(len(draft.speed_mps), otherwise) if values is None else values


def _middle(values: np.ndarray) -> np.ndarray:
    return 0.5 * (values[1:] + values[:-1])


def _window() -> int:
    return round(CRITERIA.jerk_window_s / STEP_S)


def _mean_rate(values: np.ndarray) -> np.ndarray:
    """Rate of change, mean over the window."""
    return (values[_window() :] - values[: -_window()]) / CRITERIA.jerk_window_s


def _window_most(values: np.ndarray) -> np.ndarray:
    """The greatest value in each window: the limit there is the lowest."""
    return np.maximum(values[_window() :], values[: -_window()])
