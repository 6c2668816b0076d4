"""Which field says a thing where both the INS and the chassis do: the first of a list that says anything.

Learning takes the INS first, which has no wheel that slips and no radius. What is checked, and what a bench's
controller hears, is the chassis: there it comes first.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tunefree_hil.learn.drives import Drive

INS_FIRST_SPEEDS = ("ins.speed_mps", "report.speed_mps")
INS_FIRST_YAW_RATES = ("ins.yaw_rate_radps", "report.yaw_rate_radps")
CHASSIS_FIRST_SPEEDS = ("report.speed_mps", "ins.speed_mps")
CHASSIS_FIRST_YAW_RATES = ("report.yaw_rate_radps", "ins.yaw_rate_radps")


def first_told(drive: Drive, names: Sequence[str]) -> str | None:
    """The first of these fields that says a number anywhere in a drive."""
    for name in names:
        values = drive.get(name)
        if values is not None and np.isfinite(values).any():
            return name
    return None
