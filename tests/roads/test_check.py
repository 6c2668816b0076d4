"""Each limit of a made road is found where it is broken, with its time, and a road that breaks one is made smaller."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from tests import other_vehicle
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.roads.check import RoadQuantity, excess_text, find_excesses
from tunefree_hil.roads.draft import STEP_S, RoadDraft, RoadRequest
from tunefree_hil.roads.families import RoadFamily
from tunefree_hil.roads.generation import RoadLabel, make_road
from tunefree_hil.roads.limits import RoadLimits, by_iso_speed, road_limits
from tunefree_hil.roads.traces import smooth_step

MKZ = road_limits(load_vehicle(other_vehicle.FIRST))
LABEL = RoadLabel("s1", 1, "test")
TIME = np.arange(201) * STEP_S
CALM = RoadDraft(np.full(201, 10.0), np.zeros(201), "calm")


def smooth(height: float, duration_s: float = 2.0) -> np.ndarray:
    return height * smooth_step(TIME, 5.0, duration_s)


BROKEN = [
    (RoadQuantity.DURATION, RoadDraft(np.full(320, 10.0), np.zeros(320), "")),
    (RoadQuantity.SPEED, CALM._replace(speed_mps=np.full(201, 30.1))),
    (RoadQuantity.ACCEL, CALM._replace(speed_mps=10.0 + smooth(6.0, 7.0))),
    (RoadQuantity.ACCEL, CALM._replace(grade_rad=smooth(0.15))),
    (RoadQuantity.DECEL, CALM._replace(speed_mps=20.0 - smooth(16.0, 6.5))),
    (RoadQuantity.JERK, CALM._replace(speed_mps=10.0 - smooth(1.2, 0.8))),
    (RoadQuantity.CURVATURE, CALM._replace(speed_mps=np.full(201, 3.0), curvature_1pm=smooth(0.2, 8.0))),
    (RoadQuantity.CURVATURE_RATE, CALM._replace(speed_mps=np.full(201, 3.0), curvature_1pm=smooth(0.1, 1.0))),
    (RoadQuantity.LATERAL_ACCEL, CALM._replace(curvature_1pm=smooth(0.031, 4.0))),
    (RoadQuantity.LATERAL_ACCEL, CALM._replace(bank_rad=smooth(0.33))),
    (RoadQuantity.LATERAL_ACCEL, CALM._replace(curvature_1pm=smooth(0.02, 4.0), side_wind_mps2=smooth(-1.2))),
    (RoadQuantity.GRIP, CALM._replace(bank_rad=smooth(-0.2), friction_frac=np.full(201, 0.3))),
    (RoadQuantity.LATERAL_JERK, CALM._replace(speed_mps=np.full(201, 20.0), curvature_1pm=smooth(0.007, 0.6))),
    (RoadQuantity.GRIP, CALM._replace(curvature_1pm=smooth(0.02, 4.0), friction_frac=np.full(201, 0.3))),
]


def test_a_calm_road_is_within_all_limits() -> None:
    assert find_excesses(CALM, MKZ) == []


def test_a_bank_into_the_bend_takes_load_off_the_tyres() -> None:
    """Left side down in a bend to the left: gravity helps, as a wind from the right would."""
    bend = CALM._replace(curvature_1pm=smooth(0.034, 6.0))
    assert [excess.quantity for excess in find_excesses(bend, MKZ)] == [RoadQuantity.LATERAL_ACCEL]
    assert find_excesses(bend._replace(bank_rad=smooth(-0.06)), MKZ) == []
    assert find_excesses(bend._replace(side_wind_mps2=smooth(0.6)), MKZ) == []


@pytest.mark.parametrize(("quantity", "draft"), BROKEN, ids=lambda value: getattr(value, "name", ""))
def test_each_limit_is_found(quantity: RoadQuantity, draft: RoadDraft) -> None:
    excesses = find_excesses(draft, MKZ)
    assert [excess.quantity for excess in excesses] == [quantity]
    assert excesses[0].value > excesses[0].limit > 0.0
    assert "the limit is" in excess_text(excesses[0])


def test_the_limits_of_iso_15622_fall_between_5_and_20_metres_a_second() -> None:
    assert [float(by_iso_speed(speed, 4.0, 2.0)) for speed in (0.0, 5.0, 12.5, 20.0, 40.0)] == [4.0, 4.0, 3.0, 2.0, 2.0]


def test_the_limits_of_a_vehicle_are_shares_of_its_folder() -> None:
    """5 m/s2 to the side, 2 and -6 m/s2 along; 0.6 of each. Acceleration falls with speed from 15 m/s on."""
    assert (MKZ.lateral_accel_mps2, MKZ.accel_mps2, MKZ.decel_mps2) == pytest.approx((3.0, 1.2, 3.6))
    assert float(MKZ.accel_at_mps2(10.0)) == pytest.approx(1.2)
    assert float(MKZ.accel_at_mps2(30.0)) == pytest.approx(0.6)
    assert float(MKZ.decel_at_mps2(30.0)) == pytest.approx(3.5)
    assert float(MKZ.curvature_1pm(30.0)) < 0.5 * float(MKZ.curvature_1pm(0.0))  # understeer
    assert MKZ.speed_mps == 30.0


def test_a_vehicle_with_less_grip_has_gentler_roads() -> None:
    other = load_vehicle(other_vehicle.FOLDER)
    assert 0.6 * other.limits.lateral_accel_mps2 < 3.0
    assert road_limits(other).lateral_accel_mps2 == pytest.approx(0.6 * other.limits.lateral_accel_mps2)


def steady(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Twice the requested lateral acceleration."""
    lateral = 2.0 * request.lateral_accel_mps2 * smooth_step(TIME, 5.0, 4.0)
    return RoadDraft(np.full(201, 20.0), lateral / 400.0, "greedy")


def endless(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    return RoadDraft(np.full(400, 10.0), np.zeros(400), "endless")


def test_a_road_that_asks_for_too_much_is_made_smaller() -> None:
    spec = make_road(RoadFamily("greedy", 1.0, 30.0, steady), RoadRequest(20.0, 3.0, 0.5), MKZ, LABEL)
    assert 0.85 * 3.0 < 400.0 * max(spec.curvature.value) <= 3.0


def test_a_road_that_never_fits_is_refused_with_family_and_limit() -> None:
    with pytest.raises(InputError) as caught:
        make_road(RoadFamily("endless", 1.0, 30.0, endless), RoadRequest(20.0, 3.0, 0.5), MKZ, LABEL)
    assert "endless" in caught.value.message and "duration 39.9 s" in caught.value.message
    assert "30 s" in caught.value.message and caught.value.hint
