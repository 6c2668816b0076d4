"""Misses that are loud for a moment and calm else: oscillations, holes, whatever comes and goes by itself.

A regression on commands foretells nothing of them (leftover.py), and the mean over a drive hides them. A drive is cut
into windows; the loudest few are held against the ordinary one in which the signal moves, which is the sensor's noise
and what a model misses everywhere, and against the signal. Who explains a drive but for such moments has not found
what makes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Array = np.ndarray

WINDOW_S = 0.5  # half a turn at 1 Hz, a few at what shakes faster
LOUDEST = 0.02  # of the windows: a second in a minute
FEWEST_WINDOWS = 50
MOVES = 0.05  # of the signal's deviation, within a window: what moves less stands, and its miss is rounding
FEWEST_MOVING = 10  # windows that move, for one of them to be the ordinary one
ORDINARY = 10.0  # times the ordinary window's square
NOISY = 5.0  # times that: what noise alone comes to in the loudest, which is no moment's
BLOCKS = 2  # in which there are such windows: once may be a pothole, for what a road shakes


class Burst(NamedTuple):
    """Root mean squares of the loudest windows and of the ordinary one, in the target's unit; blocks with loud ones;
    signal: root mean square of what was measured in the loudest windows, about its mean.
    """

    loud: float
    ordinary: float
    blocks: int
    signal: float = 0.0

    def share(self, size: float, blocks: int = BLOCKS) -> float:
        """Of the signal, what the loudest windows miss beyond noise; 0 where they are no louder than that may make, or
        are in fewer than so many blocks.

        size: deviation of the signal over the drives. Where it stands for most of them that says little of the moments
        in which it does not, and they are held against what it was then.
        """
        stands_out = self.blocks >= blocks and self.loud**2 > ORDINARY * self.ordinary**2
        beyond = self.loud**2 - NOISY * self.ordinary**2
        return beyond**0.5 / max(size, self.signal, 1e-12) if stands_out else 0.0


def burst_of(
    residual: Sequence[Array], measured: Sequence[Array], valid: Sequence[Array], block: Sequence[Array],
    blocks: Array, dt_s: float,
) -> Burst:  # fmt: skip
    """Of a target, all drives; rows of `blocks` only. Nothing is loud in too few windows."""
    rows = max(round(WINDOW_S / dt_s), 1)
    missed, at = _joint(residual, valid, block, rows)
    signal, _ = _joint(measured, valid, block, rows)
    seen = np.isin(at, blocks)
    missed, signal, at = missed[seen], signal[seen], at[seen]
    if len(missed) < FEWEST_WINDOWS:
        return Burst(0.0, 0.0, 0)
    squares = np.mean(missed**2, axis=1)
    moves = np.ptp(signal, axis=1) > MOVES * signal.std()
    ordinary = float(np.median(squares[moves] if moves.sum() >= FEWEST_MOVING else squares))
    loudest = np.argsort(squares)[-max(round(LOUDEST * len(squares)), 1) :]
    there = float(np.mean((signal[loudest] - signal.mean()) ** 2)) ** 0.5
    loud = float(squares[loudest].mean()) ** 0.5
    return Burst(loud, ordinary**0.5, len(np.unique(at[squares > ORDINARY * ordinary])), there)


def _joint(values: Sequence[Array], valid: Sequence[Array], block: Sequence[Array], rows: int) -> tuple[Array, Array]:
    """Windows of all drives, one behind the other, with their blocks."""
    pieces = [windows_of(*one, rows) for one in zip(values, valid, block, strict=True)]
    return np.concatenate([some for some, _ in pieces]), np.concatenate([where for _, where in pieces])


def windows_of(values: Array, valid: Array, block: Array, rows: int) -> tuple[Array, Array]:
    """(whole windows of so many rows [w, rows], the block of each [w]): all their rows count, and are of one block."""
    count = len(values) // rows
    cut = [one[: count * rows].reshape(count, rows) for one in (values, valid, block)]
    whole = cut[1].all(axis=1) & (cut[2] == cut[2][:, :1]).all(axis=1) & (cut[2][:, 0] >= 0)
    return cut[0][whole], cut[2][whole, 0]
