"""Which stretches of a drive are searched, which of these choose what a repair moves, and which prove it, touched once.

Blocks with a guard behind each, taken in turn over the whole drive (fit, choice, fit, proof): rows next to each other
are nearly the same measurement, and what a drive shows changes over its time. A block is BLOCK_S long. Where all drives
together do not hold FEWEST of these, as a recording of one minute does not, blocks are as long as give FEWEST, but
a drive is never cut shorter than SHORTEST_S: a residual hangs together for up to 4 s (gap/estimation/noise.py), and what is tested
block by block must be several pieces of news and not one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Array = np.ndarray

BLOCK_S, SHORTEST_S = 8.0, 5.0
GUARD_S = 1.0  # behind a block of BLOCK_S; behind a shorter one as much less
FIT, CHOICE, PROOF, GUARD = 0, 1, 2, -1
TURN = (FIT, CHOICE, FIT, PROOF)
FEWEST = 8  # blocks: two to prove, two to choose by
FEWEST_DRIVEN = 7  # in which the car drives: many a recording begins at rest, or by hand


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


def block_s_of(ticks: Sequence[int], dt_s: float) -> float:
    """How long a block of drives of so many rows is at least, s, without its guard."""
    share = 1.0 + GUARD_S / BLOCK_S
    lengths = [rows * dt_s / (count * share) for rows in ticks for count in range(1, FEWEST + 1)]
    fitting = [one for one in lengths if SHORTEST_S <= one < BLOCK_S and _count(ticks, dt_s, one) >= FEWEST]
    if _count(ticks, dt_s, BLOCK_S) >= FEWEST:
        return BLOCK_S
    return max(fitting, default=SHORTEST_S)


def _count(ticks: Sequence[int], dt_s: float, block_s: float) -> int:
    """How many blocks of a length drives hold."""
    return sum(_count_of(rows, dt_s, block_s) for rows in ticks)


def _count_of(rows: int, dt_s: float, block_s: float) -> int:
    """Of one drive; one that is shorter than a block is one by itself."""
    return max(1, int(rows * dt_s / (block_s * (1.0 + GUARD_S / BLOCK_S)) + 1e-9))


def blocks_of(ticks: Sequence[int], dt_s: float) -> Blocks:
    """Blocks of drives of so many rows; a drive that is shorter than a block is one by itself."""
    found: list[tuple[int, int, int, int]] = []
    block_s = block_s_of(ticks, dt_s)
    for drive, rows in enumerate(ticks):
        count = _count_of(rows, dt_s, block_s)
        edges = np.linspace(0, rows, count + 1).round().astype(int)
        guard = round(GUARD_S * block_s / BLOCK_S / dt_s) if count > 1 else 0
        for i in range(count):
            found.append((TURN[len(found) % len(TURN)], int(edges[i]), int(edges[i + 1]) - guard, drive))
    return Blocks(*(np.array(column, dtype=np.int64) for column in zip(*found, strict=True)))


def block_at(blocks: Blocks, drive: int, rows: Array) -> Array:
    """The block of each row of a drive; GUARD between two."""
    found = np.full(len(rows), GUARD, dtype=np.int64)
    for i in np.flatnonzero(blocks.drives == drive):
        found[(rows >= blocks.begins[i]) & (rows < blocks.ends[i])] = i
    return found
