"""Blocks: what is fitted on, chosen by and proved on never touch."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.gap.measured.blocks import (
    BLOCK_CRITERIA,
    FIT,
    GUARD,
    HOLDOUT,
    SELECTION,
    block_length_s,
    cut_blocks,
    find_block_indices,
)


@given(st.lists(st.integers(100, 80_000), min_size=1, max_size=4))
def test_blocks_are_long_enough_and_apart(ticks: list[int]) -> None:
    blocks, block_s = cut_blocks(ticks, 0.01), block_length_s(ticks, 0.01)
    guard_s = BLOCK_CRITERIA.guard_s * block_s / BLOCK_CRITERIA.block_s
    for drive, rows in enumerate(ticks):
        own = blocks.drives == drive
        begins, ends = blocks.begins[own], blocks.ends[own]
        assert begins[0] == 0 and ends[-1] <= rows
        assert (begins[1:] - ends[:-1] >= guard_s / 0.01 - 1).all()
        if own.sum() > 1:
            assert ((ends - begins) * 0.01 >= block_s - 0.03).all()


@given(st.lists(st.integers(100, 20_000), min_size=1, max_size=4))
def test_blocks_are_shorter_only_where_there_would_be_too_few(ticks: list[int]) -> None:
    block_s, blocks = block_length_s(ticks, 0.01), cut_blocks(ticks, 0.01)
    assert BLOCK_CRITERIA.min_block_s <= block_s <= BLOCK_CRITERIA.block_s
    whole = sum(max(1, int(rows * 0.01 / (BLOCK_CRITERIA.block_s + BLOCK_CRITERIA.guard_s) + 1e-9)) for rows in ticks)
    assert (block_s == BLOCK_CRITERIA.block_s) == (whole >= BLOCK_CRITERIA.min_blocks)
    assert blocks.count >= min(whole, BLOCK_CRITERIA.min_blocks)
    if blocks.count < BLOCK_CRITERIA.min_blocks:
        assert block_s == BLOCK_CRITERIA.min_block_s, "even the shortest are too few"
    elif block_s < BLOCK_CRITERIA.block_s:
        longer = sum(
            max(1, int(rows * 0.01 / (1.02 * block_s * (1.0 + BLOCK_CRITERIA.guard_s / BLOCK_CRITERIA.block_s))))
            for rows in ticks
        )
        assert longer < BLOCK_CRITERIA.min_blocks or 1.02 * block_s > BLOCK_CRITERIA.block_s, "as long as they can be"


def test_a_minute_is_enough_and_half_of_it_is_not() -> None:
    for rows, dt_s in ((6_000, 0.01), (29_995, 0.002), (5_000, 0.01)):  # a minute; the same in steps of 2 ms; 50 s
        roles = cut_blocks([rows], dt_s).roles
        assert [int((roles == role).sum()) for role in (FIT, SELECTION, HOLDOUT)] == [4, 2, 2]
    assert cut_blocks([4_000], 0.01).count < BLOCK_CRITERIA.min_blocks
    assert (
        cut_blocks([7_200], 0.01).count == BLOCK_CRITERIA.min_blocks
        and block_length_s([7_200], 0.01) == BLOCK_CRITERIA.block_s
    )


def test_half_is_fitted_on_and_a_quarter_each_chooses_and_proves_all_over_the_drive() -> None:
    blocks = cut_blocks([36_000], 0.01)
    share = {role: float(np.mean(blocks.roles == role)) for role in (FIT, SELECTION, HOLDOUT)}
    assert share == {FIT: 0.5, SELECTION: 0.25, HOLDOUT: 0.25}
    proof = np.flatnonzero(blocks.roles == HOLDOUT)
    assert np.ptp(proof) > 0.8 * blocks.count


def test_a_row_is_in_its_block_or_in_none() -> None:
    blocks = cut_blocks([5_000, 5_000], 0.01)
    found = find_block_indices(blocks, 1, np.arange(5_000))
    assert set(np.unique(found)) == {GUARD, *np.flatnonzero(blocks.drives == 1).tolist()}
