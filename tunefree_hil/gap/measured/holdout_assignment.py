"""Which blocks are the holdout: every fourth, but not one that alone reaches an extreme of the inputs.

An effect may show only at an extreme of the commands: a steering stop, the engine's power, the tyres' grip.
If the only turn that reaches it is in the holdout, the search cannot find the effect. Such a block therefore changes
places with a neighbour, unless that neighbour holds another extreme. Only the inputs decide, never the model's errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.measured.blocks import HOLDOUT, Blocks, cut_blocks
from tunefree_hil.gap.measured.chain import MeasuredDrive, is_replayable

Array = np.ndarray


class ExtremeCriteria(NamedTuple):
    """When an extreme is covered without the holdout (docs/results/criteria.md)."""

    min_coverage: float = 0.8  # of the way from the least to the most of all blocks
    rate_window_s: float = 0.2  # over which a command's change is taken: long against a tick, short against a turn


EXTREME_CRITERIA = ExtremeCriteria()


def assign_holdout_blocks(drives: Sequence[MeasuredDrive]) -> Blocks:
    """Cut drives into blocks and assign their roles."""
    blocks = cut_blocks([drive.ticks for drive in drives], drives[0].dt_s)
    parts = [
        (drives[drive], slice(begin, end))
        for drive, begin, end in zip(blocks.drives, blocks.begins, blocks.ends, strict=True)
    ]
    replayable = np.array([is_replayable(*part) for part in parts])
    extremes = np.stack([find_block_extremes(*part) for part in parts])
    return blocks._replace(roles=cover_extremes(blocks, extremes, replayable))


def cover_extremes(blocks: Blocks, extremes: Array, replayable: Array) -> Array:
    """Swap roles so that the fit and selection blocks cover the extremes.

    Args:
        blocks: blocks with the roles of ROLE_CYCLE.
        extremes: (n_blocks, k), greatest value of each quantity; NaN where a block does not show it.
        replayable: (n_blocks,), whether a block can be replayed as a whole; others prove nothing and are swapped last.

    Returns:
        (n_blocks,) roles, as many of each as before.
    """
    roles, scaled = blocks.roles.copy(), _scale_extremes(extremes)
    for k in range(scaled.shape[1]):
        if _find_covered(roles, scaled)[k] or scaled[:, k].max(initial=0.0) <= 0.0:
            continue
        top = int(np.argmax(scaled[:, k]))
        for partner in _order_partners(roles, blocks, top, replayable):
            swapped = roles.copy()
            swapped[[top, partner]] = roles[[partner, top]]
            if (_find_covered(swapped, scaled) >= _find_covered(roles, scaled)).all():  # no other extreme is lost
                roles = swapped
                break
    return roles


def _scale_extremes(extremes: Array) -> Array:
    """(n_blocks, k): shares of the way from the least to the most of all blocks; 0 where a block shows nothing."""
    is_known = np.isfinite(extremes)
    least = np.where(is_known, extremes, np.inf).min(axis=0)
    span = np.where(is_known, extremes, -np.inf).max(axis=0) - least
    varies = np.isfinite(span) & (span > 0.0)
    return np.where(is_known & varies, (extremes - least) / np.where(varies, span, 1.0), 0.0)


def _find_covered(roles: Array, scaled: Array) -> Array:
    """(k,): whether fit and selection blocks reach nearly as far as any block."""
    most: Array = scaled[roles != HOLDOUT].max(axis=0, initial=0.0)
    return most >= EXTREME_CRITERIA.min_coverage


def _order_partners(roles: Array, blocks: Blocks, block: int, replayable: Array) -> list[int]:
    """Fit and selection blocks to swap with: replayable ones first, then the same drive's, then the nearest."""
    drive = blocks.drives[block]
    partners = np.flatnonzero(roles != HOLDOUT).tolist()
    return sorted(partners, key=lambda i: (not replayable[i], blocks.drives[i] != drive, abs(i - block)))


def find_block_extremes(drive: MeasuredDrive, rows: slice) -> Array:
    """The greatest values in a block, (k,), of quantities in which a limit may lie; NaN where a block shows nothing.

    Of each command its size and its change, as far as commands act; throttle times speed, which is the engine's power;
    the square of the speed times the steering angle, which is the tyres' force; speed.
    """
    x = drive.inputs
    speed, is_moving = x.speed_mps[rows], drive.is_moving[rows]
    back = max(round(EXTREME_CRITERIA.rate_window_s / drive.dt_s), 1)
    extremes = []
    for i in range(3):
        acts = is_moving & (drive.command_active[rows, i] > 0.5)
        signed = x.commands[rows, i]
        command, change = np.abs(signed), np.abs(signed[back:] - signed[:-back])
        beyond_rest = command - np.abs(x.commands[:, i]).min()  # a pedal at rest gives nothing
        extremes += [_max_of_rows(command, acts), _max_of_rows(change, acts[back:] & acts[:-back])]
        extremes += [_max_of_rows(load, acts) for load in ((beyond_rest * speed,), (), (speed**2 * command,))[i]]
    return np.array([*extremes, _max_of_rows(speed, is_moving)])


def _max_of_rows(values: Array, rows: Array) -> float:
    return float(values[rows].max()) if rows.any() else np.nan
