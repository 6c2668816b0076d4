"""A road on a time grid, as a family makes it, and the request that it is made for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

STEP_S = 0.1  # of the grid; every signal of a family is slow against it


class RoadRequest(NamedTuple):
    """What a road is to ask for; a family asks for less where the vehicle's limits need it.

    Attributes:
        speed_mps: Speed of the manoeuvre.
        lateral_accel_mps2: Greatest lateral acceleration, positive.
        longitudinal_share: Share of the acceleration and deceleration that the limits allow at the speed, 0 to 1.
        is_left: Whether the first bend is to the left.
        ease: Factor on the time that ramps take, from 1 on.
    """

    speed_mps: float
    lateral_accel_mps2: float
    longitudinal_share: float
    is_left: bool = True
    ease: float = 1.0

    @property
    def side(self) -> float:
        """Sign of the first bend."""
        return 1.0 if self.is_left else -1.0


class RoadDraft(NamedTuple):
    """Signals of a road every STEP_S, arrays of equal length.

    Attributes:
        grade_rad: Slope, positive uphill; None: level.
        friction_frac: Share of the model's own friction; None: 1.
        bank_rad: Bank, positive with the left side up; None: level.
        side_wind_mps2: Force of a side wind over the vehicle's mass, to the left; None: none.
        description: The road in a sentence.
    """

    speed_mps: np.ndarray
    curvature_1pm: np.ndarray
    description: str
    grade_rad: np.ndarray | None = None
    friction_frac: np.ndarray | None = None
    bank_rad: np.ndarray | None = None
    side_wind_mps2: np.ndarray | None = None

    @property
    def time_s(self) -> np.ndarray:
        """The grid."""
        return np.arange(len(self.speed_mps)) * STEP_S
