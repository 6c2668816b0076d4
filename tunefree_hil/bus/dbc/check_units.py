"""Checks that the scale of vehicle.toml turns the DBC's unit into SI. Unknown units pass."""

from __future__ import annotations

import math
from collections.abc import Mapping

TOLERANCE = 0.005  # relative; factors are often written with a few digits
QUANTITIES = {  # ending of a record field's name -> what it is, in words
    "_mps2": "an acceleration in m/s2",
    "_mps": "a speed in m/s",
    "_radps": "a rate of turn in rad/s",
    "_rad": "an angle in rad",
    "_frac": "a share of 1",
    "_nm": "a torque in Nm",
    "_m": "a length in m",
}
ANY = math.nan  # needs a number of the vehicle (a wheel's radius) that is not known here
_DEG = math.pi / 180.0
UNITS: Mapping[str, Mapping[str, float]] = {  # unit, lower case -> what it can be, and its factor to SI
    "m/s": {"_mps": 1.0, "_radps": ANY},
    "km/h": {"_mps": 1.0 / 3.6, "_radps": ANY},
    "kph": {"_mps": 1.0 / 3.6, "_radps": ANY},
    "mph": {"_mps": 0.44704, "_radps": ANY},
    "m/s^2": {"_mps2": 1.0},
    "m/s2": {"_mps2": 1.0},
    "g": {"_mps2": 9.80665},
    "deg": {"_rad": _DEG},
    "rad": {"_rad": 1.0},
    "deg/s": {"_radps": _DEG},
    "rad/s": {"_radps": 1.0},
    "rpm": {"_radps": math.pi / 30.0},
    "1/min": {"_radps": math.pi / 30.0},
    "%": {"_frac": 0.01},
    "nm": {"_nm": 1.0},
    "m": {"_m": 1.0},
    "cm": {"_m": 0.01},
    "mm": {"_m": 0.001},
}


def check_unit(field: str, unit: str | None, scale: float) -> tuple[str, str] | None:
    """(what is wrong, what to do) with the total scale of a signal in a record field, or None."""
    quantity = next((ending for ending in QUANTITIES if field.endswith(ending)), "")
    known = UNITS.get((unit or "").strip().lower())
    if not quantity or known is None:
        return None
    wanted = known.get(quantity)
    if wanted is None:
        return (
            f"it is in {unit}, and {field} is {QUANTITIES[quantity]}",
            "map another signal, or correct the DBC's unit",
        )
    if math.isnan(wanted) or abs(abs(scale) / wanted - 1.0) <= TOLERANCE:
        return None
    return (
        f"it is in {unit}, which scale = {scale:g} does not make {QUANTITIES[quantity]}",
        f"scale = {wanted:.9g}, negative where the wire's sign is the other one; or correct the DBC's unit",
    )
