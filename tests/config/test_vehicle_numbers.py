"""Every number of a vehicle.toml has a range, and what is outside of it is named; the project's vehicles are inside."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import fields, replace

from tests.house import ROOT
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.vehicle_numbers import RANGES, Range, check_numbers
from tunefree_hil.config.vehicle_schema import (
    InsFrameSpec,
    LatencySpec,
    LimitsSpec,
    NominalSpec,
    OverrideSpec,
    Spec,
    VehicleSpec,
)

TABLES: dict[str, type[Spec]] = {
    "top": VehicleSpec,
    "ins_frame": InsFrameSpec,
    "latency": LatencySpec,
    "override": OverrideSpec,
    "limits": LimitsSpec,
    "nominal": NominalSpec,
}
CAR = load_vehicle("mkz_bywire", check=False)
KEYS = [(table, name) for table, ranges in RANGES.items() for name in ranges]


def with_value(table: str, **values: Any) -> VehicleSpec:
    """The MKZ with other values in one table ('top': of the file, 'latency': that of its steering)."""
    if table == "top":
        return replace(CAR, **values)
    if table == "latency":
        return replace(CAR, latency={"steer": replace(CAR.latency["steer"], **values)})
    return replace(CAR, **{table: replace(getattr(CAR, table), **values)})


def key_of(table: str, name: str) -> str:
    return {"top": name, "latency": f"latency.steer.{name}"}.get(table, f"{table}.{name}")


def slips(spec: VehicleSpec) -> dict[str, str]:
    return {key: message for key, message, _ in check_numbers(spec)}


@pytest.mark.parametrize("table", TABLES)
def test_every_numeric_key_has_a_range(table: str) -> None:
    numeric = {field.name for field in fields(TABLES[table]) if field.type in (int, float, int | None, float | None)}
    assert numeric == set(RANGES[table])


@pytest.mark.parametrize(("table", "name"), KEYS)
def test_a_number_outside_its_range_is_named(table: str, name: str) -> None:
    allowed = RANGES[table][name]
    wrong = [-1, 10**400] if table == "top" else [-1e-9, -1e308, math.nextafter(allowed.high, math.inf), 1e308]
    for value in [*wrong, *([allowed.low] if allowed.above else [])]:
        assert key_of(table, name) in slips(with_value(table, **{name: value})), value


@given(st.sampled_from(KEYS), st.floats(0.0, 1.0))
def test_a_number_inside_its_range_may_stand_by_itself(key: tuple[str, str], share: float) -> None:
    allowed: Range = RANGES[key[0]][key[1]]
    value = allowed.low + share * (allowed.high - allowed.low)
    assert (allowed.slip(value) is None) == (value > allowed.low or not allowed.above)


@pytest.mark.parametrize(
    ("table", "values", "key", "words"),
    [
        ("nominal", {"front_axle_m": 5.0, "wheelbase_m": 2.84}, "nominal.front_axle_m", "not below wheelbase_m = 2.84"),
        ("nominal", {"front_axle_m": 2.84, "wheelbase_m": 2.84}, "nominal.front_axle_m", "not below"),
        ("nominal", {"rest_pedal_frac": 0.5}, "nominal.rest_pedal_frac", "not below limits.brake_frac = 0.5"),
        ("limits", {"throttle_frac": 0.1}, "nominal.rest_pedal_frac", "not below limits.throttle_frac = 0.1"),
        ("limits", {"throttle_frac": 100.0}, "limits.throttle_frac", "100.0 is above 1"),
        ("limits", {"accel_mps2": [-6.0, 1e308]}, "limits.accel_mps2", "[low, high]"),
        ("limits", {"accel_mps2": [-6.0]}, "limits.accel_mps2", "[low, high]"),
        ("ins_frame", {"origin": [91.0, 0.0]}, "ins_frame.origin", "no [latitude, longitude]"),
        ("ins_frame", {"origin": [1.0]}, "ins_frame.origin", "no [latitude, longitude]"),
    ],
)
def test_numbers_that_do_not_fit_each_other(table: str, values: dict[str, Any], key: str, words: str) -> None:
    found = slips(with_value(table, **values))
    assert list(found) == [key] and words in found[key]


def test_an_origin_on_the_globe_may_stand() -> None:
    assert slips(with_value("ins_frame", origin=[-37.4, 180.0])) == {}


def test_the_vehicles_of_the_project_are_inside() -> None:
    folders = [path.parent for where in ("dbc", "tests") for path in (ROOT / where).rglob("vehicle.toml")]
    assert len(folders) >= 4
    for folder in folders:
        assert slips(load_vehicle(folder, check=False)) == {}, folder


def test_no_stiffness_is_refused_where_a_vehicle_is_loaded(tmp_path: Any) -> None:
    text = (ROOT / "dbc" / "mkz_bywire" / "vehicle.toml").read_text()
    (tmp_path / "vehicle.toml").write_text(
        text.replace("front_stiffness_n_per_rad = 155494.663", "front_stiffness_n_per_rad = 0.0")
    )
    with pytest.raises(InputError, match=r"nominal\.front_stiffness_n_per_rad") as caught:
        load_vehicle(tmp_path)
    assert "above 0" in caught.value.hint
