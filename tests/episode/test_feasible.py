"""What a vehicle cannot do is found, with the time and the limit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import LimitsSpec, NominalSpec, ProfileSpec, ScenarioSpec, VehicleSpec
from tunefree_hil.episode.feasible import CourseLimits, check_feasible, curvature_by_time, limits_of, require_feasible
from tunefree_hil.episode.scenario import build_course

# 0 to 8 m/s at 2 m/s2, a bend of 0.08 1/m reached at t = 6 s within 1 s, stop at 2 m/s2
SPEC = ScenarioSpec(
    schema="tunefree.scenario/1",
    name="test",
    speed=ProfileSpec(t_s=[0.0, 4.0, 10.0, 14.0], value=[0.0, 8.0, 8.0, 0.0]),
    curvature=ProfileSpec(t_s=[0.0, 5.0, 6.0, 8.0, 9.0], value=[0.0, 0.0, 0.08, 0.08, 0.0]),
    path="test.toml",
)
COURSE = build_course(SPEC, 0.01)
FITS = CourseLimits(0.09, 0.09, 5.2, -2.1, 2.1, 8.1)
# limits, name, when the worst point may be, the limit as printed
BROKEN = [
    (FITS._replace(speed_mps=7.9), "speed", (4.0, 10.0), "7.9"),
    (FITS._replace(accel_high_mps2=1.9), "acceleration", (0.0, 4.0), "1.9"),
    (FITS._replace(accel_low_mps2=-1.9), "deceleration", (10.0, 14.0), "1.9"),
    (FITS._replace(curvature_1pm=0.07), "curvature", (6.0, 8.0), "0.07"),
    (FITS._replace(curvature_rate_1pmps=0.07), "curvature rate", (5.0, 9.0), "0.07"),
    (FITS._replace(lateral_accel_mps2=5.0), "lateral acceleration", (6.0, 8.0), "5"),
]


def test_nothing_to_complain_of() -> None:
    assert check_feasible(COURSE, FITS) == []
    assert check_feasible(COURSE, CourseLimits()) == []
    require_feasible(SPEC, COURSE, FITS)


@pytest.mark.parametrize(("limits", "what", "between_s", "limit"), BROKEN)
def test_each_limit_is_found(limits: CourseLimits, what: str, between_s: tuple[float, float], limit: str) -> None:
    problems = check_feasible(COURSE, limits)
    assert len(problems) == 1
    assert problems[0].startswith(what)
    said = float(problems[0].split("t = ")[1].split(" s")[0])
    assert between_s[0] - 0.011 <= said <= between_s[1] + 0.011
    assert f"limit is {limit} " in problems[0]


def test_the_error_names_file_place_and_limit() -> None:
    with pytest.raises(InputError, match=r"curvature 0\.08 1/m at t = .* the limit is 0\.07 1/m; lateral") as caught:
        require_feasible(SPEC, COURSE, FITS._replace(curvature_1pm=0.07, lateral_accel_mps2=3.0))
    assert caught.value.file == "test.toml"
    assert caught.value.hint


def test_steering_at_standstill_is_a_step_in_the_path() -> None:
    """No rate of the steering wheel drives a step of curvature."""
    spec = ScenarioSpec(
        schema="tunefree.scenario/1",
        name="step",
        speed=ProfileSpec(t_s=[0.0, 2.0, 4.0, 6.0], value=[4.0, 0.0, 0.0, 4.0]),
        curvature=ProfileSpec(t_s=[0.0, 2.0, 4.0, 6.0], value=[0.0, 0.0, 0.1, 0.1]),
    )
    problems = check_feasible(build_course(spec, 0.01), CourseLimits(curvature_rate_1pmps=0.19))
    assert len(problems) == 1
    assert "steering rate" in problems[0]


def test_curvature_by_time() -> None:
    expected = np.interp(np.arange(1401) * 0.01, SPEC.curvature.t_s, SPEC.curvature.value)
    np.testing.assert_allclose(curvature_by_time(COURSE), expected, atol=1e-3)


def vehicle(**nominal: Any) -> VehicleSpec:
    return VehicleSpec(
        schema="tunefree.vehicle/1",
        name="car",
        dbc=[],
        bitrate=500000,
        limits=LimitsSpec(steer_rad=8.20305, steer_rate_radps=8.55211, throttle_frac=0.8, brake_frac=0.5),
        nominal=NominalSpec(**nominal),
    )


def test_limits_of_the_mkz() -> None:
    """Least turning radius 5.05 m (docs/reference/apollo.md); 8.55211 / 16 / 2.8448 = 0.1879 1/m/s."""
    limits = limits_of(vehicle(wheelbase_m=2.8448, steer_ratio=16.0))
    assert 1.0 / limits.curvature_1pm == pytest.approx(5.0539, abs=1e-3)
    assert limits.curvature_rate_1pmps == pytest.approx(0.18789, abs=1e-4)
    assert limits[2:] == (5.0, -6.0, 2.0, 40.0)


def test_an_unknown_wheelbase_limits_nothing() -> None:
    assert limits_of(vehicle(steer_ratio=16.0))[:2] == (math.inf, math.inf)
