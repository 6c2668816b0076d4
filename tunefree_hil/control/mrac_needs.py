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


def require_first_order(setup: Setup) -> None:
    """Raise InputError for settings that only the plain law has: another order than 1, and the paper's form."""
    settings = setup.settings
    if settings.mrac_order == 1 and settings.mrac_form == "apollo":
        return
    key = "controller.mrac_order" if settings.mrac_order != 1 else "controller.mrac_form"
    raise InputError(
        f"mrac_robust has neither mrac_order {settings.mrac_order} nor mrac_form '{settings.mrac_form}'",
        code="bad_mrac",
        key=key,
        hint="leave both keys out, or take inner = 'mrac'",
    )
