"""Which stretches of a drive are fitted on, which choose between names, and which are touched once to prove the repair.

Blocks of BLOCK_S with a guard behind each, taken in turn over the whole drive (fit, choice, fit, proof): rows next to
each other are nearly the same measurement, and what a drive shows changes over its time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Array = np.ndarray

BLOCK_S = 8.0
GUARD_S = 1.0
FIT, CHOICE, PROOF, GUARD = 0, 1, 2, -1
TURN = (FIT, CHOICE, FIT, PROOF)
FEWEST = 8  # blocks: two to prove, two to choose by


class Blocks(NamedTuple):
    """roles [b]: of each block; begins, ends [b]: rows of its drive; drives [b]: which drive."""

    roles: Array
    begins: Array
    ends: Array
    drives: Array

    @property
    def count(self) -> int:
        """How many."""
        return len(self.roles)


def blocks_of(ticks: Sequence[int], dt_s: float) -> Blocks:
    """Blocks of drives of so many rows; a drive that is shorter than a block is one by itself."""
    found: list[tuple[int, int, int, int]] = []
    for drive, rows in enumerate(ticks):
        count = max(1, int(rows * dt_s // (BLOCK_S + GUARD_S)))
        edges = np.linspace(0, rows, count + 1).round().astype(int)
        guard = round(GUARD_S / dt_s) if count > 1 else 0
        for i in range(count):
            found.append((TURN[len(found) % len(TURN)], int(edges[i]), int(edges[i + 1]) - guard, drive))
    return Blocks(*(np.array(column, dtype=np.int64) for column in zip(*found, strict=True)))


def block_at(blocks: Blocks, drive: int, rows: Array) -> Array:
    """The block of each row of a drive; GUARD between two."""
    found = np.full(len(rows), GUARD, dtype=np.int64)
    for i in np.flatnonzero(blocks.drives == drive):
        found[(rows >= blocks.begins[i]) & (rows < blocks.ends[i])] = i
    return found
