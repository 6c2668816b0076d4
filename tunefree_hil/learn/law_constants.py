"""Constants of the plant as the plain laws of learn/by_motion.py suggest them: where a fit may begin.

For a car whose folder states little and whose channels report nothing, and which may be a tenth of a road car's size.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from tunefree_hil.base.units import AIR_DENSITY_KGPM3, G_MPS2
from tunefree_hil.learn.by_motion import Law

LEAST_EXPLAINED = 0.3  # of the rate of speed: a law that says less is no start
KNEE, HOLDS = 0.5, 0.8  # the drive's knee; what of the least command that held a speed is taken for its zero
FAST_SHARE = 0.7  # of the top speed, at which drag is taken


def suggested(laws: Mapping[str, Law], mass_kg: float) -> dict[str, float]:
    """Values by their names in [plant.params], for those constants that the laws say something of.

    creep_force_n is 0 where the laws show none: free, it would hold any car at the one speed that it mostly drove.
    """
    found: dict[str, float] = {}
    if "steer" in laws:
        found["steer_ratio"] = laws["steer"].ratio
    throttle = laws.get("throttle")
    if throttle is not None and throttle.explained >= LEAST_EXPLAINED and len(throttle.knots) > 1:
        found |= _along(throttle, mass_kg)
    if laws and (throttle is None or throttle.explained < LEAST_EXPLAINED or throttle.coefficients[0] <= 0.0):
        found["creep_force_n"] = 0.0
    brake = laws.get("brake")
    if brake is not None and brake.explained >= LEAST_EXPLAINED and len(brake.knots) > 1:
        worth = -float(brake.coefficients[3:] @ np.diff(brake.knots))
        found["brake_force_n_per_frac"] = mass_kg * worth / float(brake.knots[-1] - brake.knots[0])
    return found


def _along(law: Law, mass_kg: float) -> dict[str, float]:
    """Rolling and drag from what no pedal pushes, drive from what the pedal is worth."""
    still, slope, bend = (float(one) for one in law.coefficients[:3])
    worth = np.concatenate([[0.0], np.cumsum(law.coefficients[3:] * np.diff(law.knots))])
    rolling_mps2 = min(max(-still, 0.02), 3.0)
    fast_mps = FAST_SHARE * law.top_mps
    drag_mps2 = max(-(slope * fast_mps + bend * fast_mps * fast_mps), 0.02)
    moves = float(np.interp(rolling_mps2, np.maximum.accumulate(worth), law.knots))  # where it begins to pull away
    zero = float(law.knots[0]) + 0.7 * (moves - float(law.knots[0]))
    force_n = 1.5 * mass_kg * max(float(worth.max()), rolling_mps2)
    least, middle, speed_mps = law.held
    if middle > 0.0:  # a start must at least hold the speed that the car held
        zero = min(zero, HOLDS * least)
        resisted = rolling_mps2 + drag_mps2 * (speed_mps / fast_mps) ** 2
        share = (middle - zero) / max(1.0 - zero, 0.1)
        force_n = mass_kg * resisted / max(1.0 - math.exp(-share / KNEE), 1e-3)
    return {
        "rolling_frac": rolling_mps2 / G_MPS2,
        "drag_area_m2": mass_kg * drag_mps2 / (0.5 * AIR_DENSITY_KGPM3 * fast_mps * fast_mps),
        "throttle_zero_frac": zero,
        "drive_force_n": force_n,
        "drive_knee_frac": KNEE,
        "drive_power_w": 2.0 * force_n * law.top_mps,
    }
