"""Blocks: what is fitted on, chosen by and proved on never touch."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.gap.segments import BLOCK_S, CHOICE, FIT, GUARD, GUARD_S, PROOF, block_at, blocks_of


@given(st.lists(st.integers(100, 80_000), min_size=1, max_size=4))
def test_blocks_are_long_enough_and_apart(ticks: list[int]) -> None:
    blocks = blocks_of(ticks, 0.01)
    for drive, rows in enumerate(ticks):
        own = blocks.drives == drive
        begins, ends = blocks.begins[own], blocks.ends[own]
        assert begins[0] == 0 and ends[-1] <= rows
        assert (begins[1:] - ends[:-1] >= GUARD_S / 0.01 - 1).all()
        if own.sum() > 1:
            assert ((ends - begins) * 0.01 >= BLOCK_S - 0.03).all()


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
