"""Blocks of drives and their roles: fit, selection (which parameters a repair moves) and holdout (used once).

Neighbouring rows are nearly the same measurement, and what a drive shows changes over its time. So the blocks take
turns over the whole drive (fit, selection, fit, holdout), with a guard after each. Where all drives together are too
short for the least number of blocks, the blocks are shorter, but not below the least length.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Array = np.ndarray


class BlockCriteria(NamedTuple):
    """Lengths and numbers of blocks (docs/results/criteria.md)."""

    block_s: float = 8.0  # length of a block where the logs are long enough for min_blocks of them
    min_block_s: float = 5.0  # a residual is correlated over up to 4 s (gap/estimation/noise.py)
    guard_s: float = 1.0  # after a block of block_s; after a shorter one in proportion
    min_blocks: int = 8  # two of them for the holdout, two for the selection
    min_driven_blocks: int = 7  # with a moving car: many recordings begin at rest, or driven by hand


BLOCK_CRITERIA = BlockCriteria()
GUARD_SHARE = BLOCK_CRITERIA.guard_s / BLOCK_CRITERIA.block_s  # of a block
FIT, SELECTION, HOLDOUT, GUARD = 0, 1, 2, -1  # roles; GUARD is also the block index of a row between two blocks
ROLE_CYCLE = (FIT, SELECTION, FIT, HOLDOUT)


class Blocks(NamedTuple):
    """Blocks, each array (n_blocks,).

    Args:
        roles: of each block.
        begins, ends: first row, and the row after the last one, of its drive.
        drives: index of its drive.
    """

    roles: Array
    begins: Array
    ends: Array
    drives: Array

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self.roles)


def block_length_s(ticks: Sequence[int], dt_s: float) -> float:
    """The length of a block without its guard, s.

    Args:
        ticks: number of rows of each drive.
        dt_s: time between two rows.
    """
    c = BLOCK_CRITERIA
    lengths = [rows * dt_s / (count * (1.0 + GUARD_SHARE)) for rows in ticks for count in range(1, c.min_blocks + 1)]
    possible = [
        length
        for length in lengths
        if c.min_block_s <= length < c.block_s and _count_blocks(ticks, dt_s, length) >= c.min_blocks
    ]
    if _count_blocks(ticks, dt_s, c.block_s) >= c.min_blocks:
        return c.block_s
    return max(possible, default=c.min_block_s)


def _count_blocks(ticks: Sequence[int], dt_s: float, block_s: float) -> int:
    """Number of blocks of a length in all drives."""
    return sum(_count_drive_blocks(rows, dt_s, block_s) for rows in ticks)


def _count_drive_blocks(rows: int, dt_s: float, block_s: float) -> int:
    """Number of blocks in one drive; a drive shorter than a block is one block."""
    return max(1, int(rows * dt_s / (block_s * (1.0 + GUARD_SHARE)) + 1e-9))


def cut_blocks(ticks: Sequence[int], dt_s: float) -> Blocks:
    """Cut drives into blocks; a drive shorter than a block is one block.

    Args:
        ticks: number of rows of each drive.
        dt_s: time between two rows.
    """
    blocks: list[tuple[int, int, int, int]] = []
    block_s = block_length_s(ticks, dt_s)
    for drive, rows in enumerate(ticks):
        count = _count_drive_blocks(rows, dt_s, block_s)
        edges = np.linspace(0, rows, count + 1).round().astype(int)
        guard = round(BLOCK_CRITERIA.guard_s * block_s / BLOCK_CRITERIA.block_s / dt_s) if count > 1 else 0
        for i in range(count):
            role = ROLE_CYCLE[len(blocks) % len(ROLE_CYCLE)]
            blocks.append((role, int(edges[i]), int(edges[i + 1]) - guard, drive))
    return Blocks(*(np.array(column, dtype=np.int64) for column in zip(*blocks, strict=True)))


def find_block_indices(blocks: Blocks, drive: int, rows: Array) -> Array:
    """The block of each row of a drive, (n_rows,); GUARD between two blocks."""
    indices = np.full(len(rows), GUARD, dtype=np.int64)
    for i in np.flatnonzero(blocks.drives == drive):
        indices[(rows >= blocks.begins[i]) & (rows < blocks.ends[i])] = i
    return indices
