"""Needs of MRAC: the measured steering angle, and the lag of the steering actuator in the data sheet."""

from __future__ import annotations

from tunefree_hil.base.errors import InputError
from tunefree_hil.control.contract import Setup

WITHOUT = "; without it set mrac.enable = 0 to drive (a tune has MRAC on, in its manual baselines too)"


def require_needs(setup: Setup, tau_s: float) -> None:
    """Raise InputError for a vehicle on which MRAC cannot work. tau_s: the actuator's lag that the data sheet states.

    With a lag of 0 the start gains have no effect and the clamp allows no change, so nothing is adapted and a search of
    its parameters has no effect. The paper's form has neither start gains nor clamp.
    """
    if "report.steer_rad" in setup.absent:
        raise InputError(
            "MRAC needs the measured steering angle, which this vehicle does not report",
            code="absent_signal",
            key="mrac.enable",
            hint=f"map report.steer_rad in vehicle.toml{WITHOUT}",
        )
    if tau_s <= 0.0 and setup.settings.mrac_form != "paper":
        raise InputError(
            "MRAC needs the lag of the steering actuator, and vehicle.toml states none: it would never adapt",
            code="no_steer_latency",
            key="mrac.enable",
            hint="write [latency.steer] with dead_time_s and rise_time_s (data sheet, or a step that you measured) into"
            f" vehicle.toml{WITHOUT}",
        )
