"""Tyres that relax: the lag of their side force is a way, not a time."""

from __future__ import annotations

import math

import pytest

from tests.effects.shared import KINDS, driven, same
from tests.plant.drives import PLANTS, REST, command
from tests.plant.test_single_track import holding_throttle
from tunefree_hil.base.course import Start


def half_way_s(kind: str, length_m: float, speed: float) -> float:
    """When the yaw rate of a small step of the steering is half of what it comes to, between ticks by a line."""
    effect = {"tyre_relaxation": {"length_m": length_m}} if length_m else {}
    throttle = holding_throttle(speed) if kind == "physics" else 0.2
    outputs = driven(kind, effect, lambda t: command(throttle, REST, 0.2), 2.5, start=Start(speed_mps=speed))
    yaw = [out.motion.yaw_rate_radps for out in outputs]
    half = 0.5 * yaw[-1]
    k = next(k for k, value in enumerate(yaw) if value > half)
    return 0.01 * (k - (yaw[k] - half) / (yaw[k] - yaw[k - 1]))


@pytest.mark.parametrize("kind", KINDS)
def test_it_delays_by_length_over_speed(kind: str) -> None:
    """Half of a step comes later by a share of length / speed: the slower the car, the longer it takes."""
    slow, fast = (half_way_s(kind, 0.6, speed) - half_way_s(kind, 0.0, speed) for speed in (6.0, 12.0))
    assert 0.25 * 0.6 / 6.0 < slow < 1.3 * 0.6 / 6.0
    assert 1.15 * fast < slow < 2.5 * fast


def test_the_way_comes_on_top_of_a_tyres_own() -> None:
    own = PLANTS["reference"].defaults["relaxation_m"]
    more = driven("reference", {"tyre_relaxation": {"length_m": 0.3}})
    assert same(more, driven("reference", {}, params={"relaxation_m": own + 0.3}))


@pytest.mark.parametrize("kind", KINDS)
def test_a_steady_curve_is_as_before(kind: str) -> None:
    def end(effect: dict[str, dict[str, float]]) -> float:
        outputs = driven(kind, effect, lambda t: command(0.24, REST, 1.0), 4.0, start=Start(speed_mps=10.0))
        return outputs[-1].motion.yaw_rate_radps

    assert end({"tyre_relaxation": {"length_m": 0.8}}) == pytest.approx(end({}), rel=5e-3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("length_m", [0.02, 0.3, 3.0])
def test_it_is_well_behaved_from_pulling_away_to_a_stop(kind: str, length_m: float) -> None:
    for speed, most_rad in ((0.0, 4.0), (9.0, 2.0), (25.0, 0.5)):
        outputs = driven(
            kind,
            {"tyre_relaxation": {"length_m": length_m}},
            lambda t: command(0.4 if t < 2.0 else REST, REST if t < 2.0 else 0.28, most_rad * math.sin(2.0 * t)),  # noqa: B023
            4.0,
            start=Start(speed_mps=speed),
        )
        assert max(abs(out.motion.yaw_rate_radps) for out in outputs) < 1.0
        assert max(abs(out.motion.side_speed_mps) for out in outputs) < 1.5
