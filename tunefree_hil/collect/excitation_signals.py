"""Excitation signals that are added to a constant pedal or steering command.

Steps identify dead time and rate limit, a chirp the lag, stairs and small sines dead band and gain.
"""

from __future__ import annotations

import math

STEPS, CHIRP, SMALL, STAIRS = range(4)
WAVE_KINDS = 4
STEP_S = 0.9
STAIR_S = 0.6
STAIR_LEVELS = (-1.0, -0.33, 0.33, 1.0, 0.33, -0.33)
SMALL_SIZE, SMALL_HZ = 0.3, 0.5
CHIRP_FROM_HZ, CHIRP_TO_HZ, CHIRP_S = 0.3, 2.5, 8.0


def excitation_wave(kind: int, time_s: float) -> float:
    """Value in [-1, 1] of a wave, time_s after its start."""
    if kind == STEPS:
        return -1.0 if int(time_s / STEP_S) % 2 else 1.0
    if kind == STAIRS:
        return STAIR_LEVELS[int(time_s / STAIR_S) % len(STAIR_LEVELS)]
    if kind == SMALL:
        return SMALL_SIZE * math.sin(2.0 * math.pi * SMALL_HZ * time_s)
    swept_s = time_s - CHIRP_S * int(time_s / CHIRP_S)
    sweep = 0.5 * (CHIRP_TO_HZ - CHIRP_FROM_HZ) / CHIRP_S
    return math.sin(2.0 * math.pi * (CHIRP_FROM_HZ + sweep * swept_s) * swept_s)
