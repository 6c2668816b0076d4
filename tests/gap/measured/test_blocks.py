"""Blocks: what is fitted on, chosen by and proved on never touch."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.gap.measured.blocks import (
    BLOCK_S,
    CHOICE,
    FEWEST,
    FIT,
    GUARD,
    GUARD_S,
    PROOF,
    SHORTEST_S,
    block_at,
    block_s_of,
    blocks_of,
)


@given(st.lists(st.integers(100, 80_000), min_size=1, max_size=4))
def test_blocks_are_long_enough_and_apart(ticks: list[int]) -> None:
    blocks, block_s = blocks_of(ticks, 0.01), block_s_of(ticks, 0.01)
    guard_s = GUARD_S * block_s / BLOCK_S
    for drive, rows in enumerate(ticks):
        own = blocks.drives == drive
        begins, ends = blocks.begins[own], blocks.ends[own]
        assert begins[0] == 0 and ends[-1] <= rows
        assert (begins[1:] - ends[:-1] >= guard_s / 0.01 - 1).all()
        if own.sum() > 1:
            assert ((ends - begins) * 0.01 >= block_s - 0.03).all()


@given(st.lists(st.integers(100, 20_000), min_size=1, max_size=4))
def test_blocks_are_shorter_only_where_there_would_be_too_few(ticks: list[int]) -> None:
    block_s, blocks = block_s_of(ticks, 0.01), blocks_of(ticks, 0.01)
    assert SHORTEST_S <= block_s <= BLOCK_S
    whole = sum(max(1, int(rows * 0.01 / (BLOCK_S + GUARD_S) + 1e-9)) for rows in ticks)
    assert (block_s == BLOCK_S) == (whole >= FEWEST)
    assert blocks.count >= min(whole, FEWEST)
    if blocks.count < FEWEST:
        assert block_s == SHORTEST_S, "even the shortest are too few"
    elif block_s < BLOCK_S:
        longer = sum(max(1, int(rows * 0.01 / (1.02 * block_s * (1.0 + GUARD_S / BLOCK_S)))) for rows in ticks)
        assert longer < FEWEST or 1.02 * block_s > BLOCK_S, "as long as they can be"


def test_a_minute_is_enough_and_half_of_it_is_not() -> None:
    for rows, dt_s in ((6_000, 0.01), (29_995, 0.002), (5_000, 0.01)):  # a minute; the same in steps of 2 ms; 50 s
        roles = blocks_of([rows], dt_s).roles
        assert [int((roles == role).sum()) for role in (FIT, CHOICE, PROOF)] == [4, 2, 2]
    assert blocks_of([4_000], 0.01).count < FEWEST
    assert blocks_of([7_200], 0.01).count == FEWEST and block_s_of([7_200], 0.01) == BLOCK_S


def test_half_is_fitted_on_and_a_quarter_each_chooses_and_proves_all_over_the_drive() -> None:
    blocks = blocks_of([36_000], 0.01)
    share = {role: float(np.mean(blocks.roles == role)) for role in (FIT, CHOICE, PROOF)}
    assert share == {FIT: 0.5, CHOICE: 0.25, PROOF: 0.25}
    proof = np.flatnonzero(blocks.roles == PROOF)
    assert np.ptp(proof) > 0.8 * blocks.count


def test_a_row_is_in_its_block_or_in_none() -> None:
    blocks = blocks_of([5_000, 5_000], 0.01)
    found = block_at(blocks, 1, np.arange(5_000))
    assert set(np.unique(found)) == {GUARD, *np.flatnonzero(blocks.drives == 1).tolist()}
