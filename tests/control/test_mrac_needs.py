"""MRAC is refused on a vehicle that it could do nothing on, in words that say what to write into vehicle.toml."""

from __future__ import annotations

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.control.contract import Settings, Setup, VehicleConstants
from tunefree_hil.control.inner import mrac
from tunefree_hil.control.parameters import BASELINES

UNKNOWN = VehicleConstants(steer_dead_time_s=0.0, steer_rise_time_s=0.0)  # as without [latency.steer]


def made(
    vehicle: VehicleConstants = UNKNOWN, enable: float = 1.0, settings: Settings | None = None, absent: str = ""
) -> mrac.MracParams:
    values = {**BASELINES["mrac_on"], "mrac.enable": enable}
    return mrac.make(Setup(values, vehicle, None, settings or Settings(), 0.01, frozenset([absent]))).params


def test_a_vehicle_that_states_no_lag_is_refused() -> None:
    with pytest.raises(InputError) as refused:
        made()
    error = refused.value
    assert (error.code, error.key) == ("no_steer_latency", "mrac.enable") and "never adapt" in error.message
    assert all(word in error.hint for word in ("[latency.steer]", "dead_time_s", "rise_time_s", "vehicle.toml"))


def test_a_vehicle_that_does_not_measure_its_angle_is_refused() -> None:
    with pytest.raises(InputError) as refused:
        made(VehicleConstants(), absent="report.steer_rad")
    assert refused.value.code == "absent_signal" and "map report.steer_rad in vehicle.toml" in refused.value.hint


def test_a_dead_time_alone_is_a_lag() -> None:
    params = made(VehicleConstants(steer_dead_time_s=0.2, steer_rise_time_s=0.0))
    assert params.x_low[0] < 0.0 and params.r_high > 1.0, "there is room to adapt in"


def test_switched_off_it_needs_nothing() -> None:
    assert made(enable=0.0).enable == 0.0
    assert made(enable=0.0, absent="report.steer_rad").enable == 0.0


def test_the_papers_form_has_no_start_from_a_data_sheet() -> None:
    assert made(settings=Settings(mrac_form="paper")).enable == 1.0
