"""A unit of the DBC and the scale of vehicle.toml have to agree; what is not known here passes."""

from __future__ import annotations

import math

import pytest

from tunefree_hil.base.records import GROUPS
from tunefree_hil.bus.dbc.check_units import QUANTITIES, UNITS, check_unit


@pytest.mark.parametrize(
    ("field", "unit", "scale"),
    [
        ("steer_rad", "deg", math.pi / 180.0),
        ("steer_rad", "deg", -0.01745),
        ("speed_mps", "km/h", 0.27778),
        ("wheel_fl_radps", "rpm", math.pi / 30.0),
        ("wheel_fl_radps", "km/h", 0.79),  # by a radius that is not known here
        ("throttle_frac", "%", 0.01),
        ("steer_torque_nm", "Nm", 1.0),
        ("steer_torque_nm", "furlong", 3.0),
        ("speed_mps", "", 0.5),
        ("speed_mps", None, 0.5),
        ("gear", "deg", 0.5),
    ],
)
def test_it_passes(field: str, unit: str | None, scale: float) -> None:
    assert check_unit(field, unit, scale) is None


@pytest.mark.parametrize(
    ("field", "unit", "scale", "says", "hint"),
    [
        ("steer_rad", "deg", 1.0, "in deg, which scale = 1", "0.0174532925"),
        ("speed_mps", "km/h", 1.0, "speed in m/s", "0.277777778"),
        ("speed_mps", "deg", 0.0174533, "speed_mps is a speed", "correct the DBC's unit"),
        ("accel_mps2", "m/s", 1.0, "accel_mps2 is an acceleration", "another signal"),
        ("brake_frac", "%", 1.0, "share of 1", "0.01"),
        ("yaw_rate_radps", "DEG/S", 1.0, "rate of turn", "0.0174532925"),
    ],
)
def test_it_is_found(field: str, unit: str, scale: float, says: str, hint: str) -> None:
    found = check_unit(field, unit, scale)
    assert found is not None and says in found[0] and hint in found[1]


def test_every_field_with_a_unit_in_its_name_has_a_quantity() -> None:
    names = [name for record in GROUPS.values() for name in record._fields if name != "gear"]
    assert [name for name in names if not any(name.endswith(ending) for ending in QUANTITIES)] == []
    assert {quantity for factors in UNITS.values() for quantity in factors} <= set(QUANTITIES)
