"""How much a vehicle's drive gives at a speed, from its open-loop map: a data sheet seldom says it.

Beyond the map's fastest row the drive gives constant power, and the drag that slows the coasting vehicle there grows
with speed squared.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tunefree_hil.base.open_loop_map import Triples


class DriveAbilityCriteria(NamedTuple):
    """How much of the drive a made road may ask for."""

    max_share: float = 0.7  # of what the drive gives; the rest is the controller's, and the map's own error
    min_accel_mps2: float = 0.1  # m/s2, left at the top speed: a grade of 1 %
    fastest_mps: float = 60.0  # m/s; no road is faster


CRITERIA = DriveAbilityCriteria()
STEP_MPS = 0.5


class DriveAbility(NamedTuple):
    """Greatest acceleration on a level road by speed, both ascending in speed; negative where drag is stronger."""

    speed_mps: tuple[float, ...]
    accel_mps2: tuple[float, ...]

    def accel_at_mps2(self, speed_mps: float | np.ndarray) -> float | np.ndarray:
        """What a made road may ask for at a speed."""
        return CRITERIA.max_share * np.interp(speed_mps, self.speed_mps, self.accel_mps2)

    def top_speed_mps(self) -> float:
        """The greatest speed at which something is left."""
        able = [
            speed
            for speed, accel in zip(self.speed_mps, self.accel_mps2, strict=True)
            if CRITERIA.max_share * accel >= CRITERIA.min_accel_mps2
        ]
        return max(able, default=0.0)


def ability_from_map(triples: Triples, rest_frac: float) -> DriveAbility:
    """The ability by the rows of an open-loop map. rest_frac: duty of a released pedal, at which the vehicle coasts."""
    speeds = sorted(set(triples.speed_mps))
    columns = [np.asarray(column) for column in triples]
    most, coasting = [], []
    for speed in speeds:
        row = columns[0] == speed
        accel, command = columns[1][row], columns[2][row]
        order = np.argsort(command)
        most.append(float(accel.max()))
        coasting.append(float(np.interp(rest_frac, command[order], accel[order])))
    last_mps, drag_mps2 = speeds[-1], min(coasting[-1], 0.0)
    beyond = np.arange(last_mps + STEP_MPS, CRITERIA.fastest_mps, STEP_MPS) if last_mps > 0.0 else np.zeros(0)
    share = beyond / last_mps if last_mps > 0.0 else beyond
    further = (most[-1] - drag_mps2) / np.maximum(share, 1.0) + drag_mps2 * share * share
    return DriveAbility((*speeds, *map(float, beyond)), (*most, *map(float, further)))
