"""The measure `actuators`: its truth is a step response, its drives excite what is to be found."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests import other_vehicle
from tools.measures._excitation import FAST_MPS, Excitation
from tools.measures.actuators import BOXES, drawn, measure, truth_of
from tunefree_hil.config.load import load_vehicle

VALUES = {
    "steer_dead_time_s": 0.1, "steer_lag_s": 0.08, "steer_motor_s": 1e-4, "steer_rate_radps": 8.0,
    "throttle_dead_time_s": 0.05, "throttle_press_s": 0.08, "throttle_release_s": 0.04,
    "brake_dead_time_s": 0.02, "brake_press_s": 0.1, "brake_release_s": 0.1,
}  # fmt: skip


def test_the_truth_of_plain_lags_is_their_time_constant() -> None:
    found = truth_of(VALUES, 0.15)
    assert found["brake"] == pytest.approx((0.02, 0.1), abs=2e-4)
    assert found["throttle"] == pytest.approx((0.05, 0.06), abs=2e-4), "the mean of pressing and letting go"
    assert found["steer"] == pytest.approx((0.1, 0.08), abs=1.5e-3), "a motor without inertia leaves the servo's lag"


def test_a_motor_makes_the_lag_longer() -> None:
    slow = truth_of({**VALUES, "steer_motor_s": 0.03}, 0.15)["steer"][1]
    assert slow > truth_of(VALUES, 0.15)["steer"][1] + 0.01


def test_vehicles_are_drawn_from_their_boxes_and_again_the_same() -> None:
    one = drawn(1, 3)
    assert one == drawn(1, 3) != drawn(1, 4)
    assert all(low - 1e-3 <= one[name] <= high + 1e-3 for name, (low, high) in BOXES.items())
    assert math.isclose(1000.0 * one["brake_dead_time_s"], round(1000.0 * one["brake_dead_time_s"]))


def test_the_excitation_stays_within_the_limits_and_moves_everything() -> None:
    vehicle = load_vehicle(other_vehicle.FOLDER)
    excitation = Excitation(vehicle, 1)
    times = np.arange(0.0, 48.0, 0.05)
    steer = np.array([excitation.steer(t, FAST_MPS) for t in times])
    assert np.ptp(steer) > 0.5 and np.abs(steer).max() <= vehicle.limits.steer_rad
    for braking, index, limit in ((False, 0, vehicle.limits.throttle_frac), (True, 1, vehicle.limits.brake_frac)):
        duty = np.array([excitation.pedals(t, braking) for t in times])
        assert duty[:, index].min() >= 0.0 and duty[:, index].max() <= limit and np.ptp(duty[:, index]) > 0.1
        assert (duty[:, 1 - index] == 0.0).all(), "the other one rests"


@pytest.mark.slow
def test_a_small_run_measures_and_goes_on(tmp_path: Path) -> None:
    found = measure(vehicles=1, seconds=60.0, folder=str(tmp_path))
    assert found["n"] >= 4 and 0.0 < found["value"] < 60.0
    assert {row["channel"] for row in found["detail"]["rows"]} == {"throttle", "brake", "steer"}
    again = measure(vehicles=1, seconds=60.0, folder=str(tmp_path))
    assert again == found
