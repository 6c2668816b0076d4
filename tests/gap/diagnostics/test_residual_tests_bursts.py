"""Loud moments are told from noise and from what is missed everywhere."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.gap.diagnostics.residual_tests import Burst, TargetRows, cut_windows, measure_burst

BLOCKS, ROWS = 15, 160
DT_S = 0.05
BLOCK = np.repeat(np.arange(BLOCKS), ROWS)
ALL = np.arange(BLOCKS)
VALID = np.ones(len(BLOCK), dtype=bool)


def noise(seed: int = 1) -> np.ndarray:
    return 0.05 * np.random.default_rng(seed).standard_normal(len(BLOCK))


TURNS = np.sin(0.7 * DT_S * np.arange(len(BLOCK)))


def burst(residual: np.ndarray, blocks: np.ndarray = ALL, measured: np.ndarray = TURNS) -> Burst:
    return measure_burst(TargetRows([residual], [measured], [VALID], [BLOCK]), blocks, DT_S)


def shaken(blocks: list[int]) -> np.ndarray:
    """A second of 4 Hz in some blocks."""
    found = noise()
    for b in blocks:
        rows = slice(b * ROWS + 40, b * ROWS + 60)
        found[rows] += 0.6 * np.sin(2.0 * np.pi * 4.0 * DT_S * np.arange(20))
    return found


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_never_loud_nor_what_is_missed_everywhere(seed: int) -> None:
    assert burst(noise(seed)).signal_share(1.0) == 0.0
    assert burst(noise(seed) + 0.5).signal_share(1.0) == 0.0


def test_what_shakes_for_a_second_in_some_blocks_is_loud() -> None:
    found = burst(shaken([2, 7, 11]))
    assert found.signal_share(1.0) == pytest.approx(0.6 / 2.0**0.5, rel=0.2) and found.loud_blocks == 3
    assert found.signal_share(0.5) == pytest.approx(2.0 * found.signal_share(1.0))


def test_one_pothole_is_none_and_blocks_that_prove_are_not_looked_at() -> None:
    assert burst(shaken([7])).signal_share(1.0) == 0.0 < 0.2 < burst(shaken([7])).signal_share(1.0, min_blocks=1)
    assert burst(shaken([2, 7, 11]), np.setdiff1d(ALL, [2, 7])).signal_share(1.0) == 0.0
    assert burst(noise()[:], np.array([0])) == Burst(0.0, 0.0, 0), "too few windows say nothing"


def stepped(every: int) -> np.ndarray:
    """A signal that stands, but for two seconds of a ramp and back in every so many blocks; ones."""
    found = np.zeros(len(BLOCK))
    for b in range(0, BLOCKS, every):
        ramp = np.linspace(0.0, 1.0, 40)
        found[b * ROWS + 40 : b * ROWS + 120] = np.concatenate([ramp, ramp[::-1]])
    return found


def test_a_signal_that_mostly_stands_is_held_against_what_it_is_when_it_moves() -> None:
    """A miss of 4 % of what moves: all there is where it moves, and calm where nothing does."""
    signal = stepped(7)
    found = burst(0.04 * signal + 1e-6 * noise(), measured=signal)
    assert found.signal_share(float(signal.std())) == 0.0, "wherever it moves it is missed as much"
    seldom = stepped(13)
    few = burst(0.04 * seldom + 1e-6 * noise(), measured=seldom + 1e-3 * TURNS)
    size = float(seldom.std())
    assert few.loud_rms > 0.15 * size and few.signal_share(size) < 0.05, (
        "too few that move: yet a small part of what it was then"
    )


def test_what_shakes_where_it_moves_is_loud_for_a_signal_that_mostly_stands() -> None:
    signal = stepped(3)
    shake = np.zeros(len(BLOCK))
    for b in (3, 6, 12):
        shake[b * ROWS + 70 : b * ROWS + 80] = 0.4 * np.sin(2.0 * np.pi * 4.0 * DT_S * np.arange(10))
    found = burst(shake + 0.01 * signal + 1e-6 * noise(), measured=signal)
    assert found.loud_blocks == 3 and found.signal_share(float(signal.std())) > 0.15


def test_windows_are_whole_and_of_one_block() -> None:
    valid = VALID.copy()
    valid[3] = False
    block = np.where(np.arange(len(BLOCK)) < 25, -1, BLOCK)
    values, at = cut_windows(np.arange(len(BLOCK), dtype=float), valid, block, 10)
    assert values[0][0] == 30.0 and values.shape[1] == 10 and set(at) == set(range(BLOCKS))
    assert len(values) == len(BLOCK) // 10 - 3
