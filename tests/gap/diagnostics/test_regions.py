"""Where a link is broken: ranges that say something, and only those stand out in which more is missed."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.gap.diagnostics.regions import REGION_CRITERIA, SIDES, Region, _Bin, _bin_edges, _test_regions

ROWS, BLOCKS = 4000, 12
AT = np.repeat(np.arange(BLOCKS), ROWS // BLOCKS + 1)[:ROWS]
CHANCE = np.random.default_rng(5)
NOISE = CHANCE.standard_normal(ROWS)


def found(values: np.ndarray) -> list[Region]:
    """Of thirds of a speed that goes up and down in every block."""
    speed = 10.0 + 5.0 * np.sin(np.arange(ROWS) * 0.1)
    edges = _bin_edges("speed (m/s)", speed)
    bins = [_Bin("speed (m/s)", low, high, (speed >= low) & (speed <= high)) for low, high in edges]
    return _test_regions(bins, values, AT, 1)


def test_a_pedal_at_rest_is_one_range_however_it_flickers() -> None:
    pedal = 0.15 + 0.0003 * np.abs(NOISE)
    pressed = np.arange(ROWS) % 10 == 0
    pedal[pressed] = 0.15 + 0.1 * CHANCE.random(pressed.sum())
    assert len(_bin_edges("brake (duty)", pedal)) == 1
    pedal[::2] = 0.15 + 0.1 * CHANCE.random(ROWS // 2)
    edges = _bin_edges("brake (duty)", pedal)
    assert [edges[0][0], edges[-1][1]] == [pedal.min(), pedal.max()] and len(edges) == 2
    assert min(high - low for low, high in edges) > REGION_CRITERIA.min_bin_share * np.ptp(pedal)


def test_what_is_spread_is_cut_into_thirds_and_what_stands_is_not_cut() -> None:
    assert _bin_edges("time (s)", np.linspace(0.0, 9.0, 1000)) == [(0.0, 3.0), (3.0, 6.0), (6.0, 9.0)]
    assert _bin_edges("throttle (duty)", np.full(100, 0.2)) == []
    assert len(_bin_edges(next(iter(SIDES)), NOISE)) == 2


def test_more_missed_at_a_speed_stands_out_and_noise_does_not() -> None:
    speed = 10.0 + 5.0 * np.sin(np.arange(ROWS) * 0.1)
    loud = found(NOISE * np.where(speed > 12.6, 3.0, 1.0))
    assert loud[0].stands_out and loud[0].high == pytest.approx(15.0, abs=0.01) and loud[0].ratio > 5.0
    assert [one.stands_out for one in loud[1:]] == [False, False]
    draws = [np.random.default_rng(seed).standard_normal(ROWS) for seed in range(40)]
    false = np.mean([any(one.stands_out for one in found(draw)) for draw in draws])
    assert false < 0.3, "a tenth is asked for, of few blocks a sixth is had"
    assert loud[0].text == f"speed (m/s) {loud[0].low:.3g} to 15"


def test_a_region_of_a_side_is_said_as_a_side() -> None:
    one = Region("steer side", 0.6, 1.0, 1.0, 0.0, 2.0, 1.5, 3.0, True)
    assert one.text == "steering to the left" and one._replace(low=0.0, high=0.4).text == "steering to the right"
