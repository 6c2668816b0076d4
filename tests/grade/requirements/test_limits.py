"""Limits of the requirements: defaults by vehicle, the bench file's, and the reserve that a search keeps."""

from __future__ import annotations

import math

import pytest

from tests import other_vehicle
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.tuning.require_schema import REQUIREMENTS, RequireSpec
from tunefree_hil.grade.requirements.limits import CRITERIA, oscillation_limits, requirement_limits, search_limits

LIMITS = load_vehicle(other_vehicle.FIRST).limits


def test_defaults_follow_the_vehicle_and_the_file_comes_first():
    limits = requirement_limits(LIMITS, None)
    assert set(limits) == set(REQUIREMENTS)
    assert limits["steer_rate_peak_radps"] == pytest.approx(0.98 * LIMITS.steer_rate_radps)
    chosen = requirement_limits(LIMITS, RequireSpec(lateral_error_peak_m=0.3, replans=math.inf))
    assert chosen["lateral_error_peak_m"] == 0.3 and "replans" not in chosen
    assert chosen["heading_error_peak_rad"] == limits["heading_error_peak_rad"]


def test_a_search_keeps_a_reserve_to_every_oscillation_and_to_nothing_else():
    limits = requirement_limits(LIMITS, None)
    kept = search_limits(limits)
    assert list(kept) == list(limits)
    for name, limit in limits.items():
        share = CRITERIA.search_share if name in oscillation_limits() else 1.0
        assert kept[name] == pytest.approx(share * limit)
    assert 0.0 < CRITERIA.search_share < 1.0
