"""Which stretches of drives are kept for the proof: every fourth, but never the only one in which a drive goes so far.

What is missing of a car may show at the ends only of what it is asked for: a stop of the steering, an engine's power, a
tyre's grip. Where the one turn that reaches such an end is kept for the proof, nobody who searches can see it, and
nothing seems to be missing. So that block changes places with a neighbour. What a drive was asked for decides, never
what a model misses of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tunefree_hil.gap.chain import Opened
from tunefree_hil.gap.segments import PROOF, Blocks, block_at, blocks_of

Array = np.ndarray

AS_FAR = 0.8  # of the way from the least to the most: who sees that much of an end sees most of what acts there
CHANGE_S = 0.2  # over which a command's change is taken: long beside a tick, short beside a turn of the wheel


def dealt(drives: Sequence[Opened]) -> Blocks:
    """The blocks of drives, with what each is for."""
    blocks = blocks_of([one.ticks for one in drives], drives[0].dt_s)
    parts = zip(blocks.drives, blocks.begins, blocks.ends, strict=True)
    whole = np.array([drives[drive].moving[begin:end].all() for drive, begin, end in parts])
    return blocks._replace(roles=seen_at_their_ends(blocks, _farthest(drives, blocks), whole))


def seen_at_their_ends(blocks: Blocks, farthest: Array, whole: Array) -> Array:
    """Roles [b]. farthest [b, k]: how far each block goes in each respect, as a share of the way from the least to the
    most of all; what it does not say is nan. whole [b]: whether the car drives all the time; another one proves nothing
    and changes places last. As many blocks as before have each role, in each drive.
    """
    roles = blocks.roles.copy()
    for k in range(farthest.shape[1]):
        if _is_covered(roles, farthest)[k] or not np.isfinite(farthest[:, k]).any():
            continue
        top = int(np.nanargmax(farthest[:, k]))
        for other in _neighbours(roles, blocks, top, whole):
            swapped = roles.copy()
            swapped[[top, other]] = roles[[other, top]]
            if (_is_covered(swapped, farthest) >= _is_covered(roles, farthest)).all():  # no other end is lost by it
                roles = swapped
                break
    return roles


def _is_covered(roles: Array, farthest: Array) -> Array:
    """[k]: whether those that are fitted on or chosen by go nearly as far as any."""
    return (np.where(np.isfinite(farthest), farthest, -np.inf)[roles != PROOF] >= AS_FAR).any(axis=0)


def _neighbours(roles: Array, blocks: Blocks, block: int, whole: Array) -> list[int]:
    """Blocks of the same drive that are not kept for the proof, whole ones first, the nearest of them first."""
    own = np.flatnonzero((roles != PROOF) & (blocks.drives == blocks.drives[block])).tolist()
    return sorted(own, key=lambda one: (not whole[one], abs(one - block)))


def _farthest(drives: Sequence[Opened], blocks: Blocks) -> Array:
    """[b, k], as `seen_at_their_ends` takes it."""
    found = np.full((blocks.count, 0), np.nan)
    for number, opened in enumerate(drives):
        asked = _asked(opened)
        if not found.shape[1]:
            found = np.full((blocks.count, asked.shape[1]), np.nan)
        at = block_at(blocks, number, np.arange(opened.ticks))
        for block in np.flatnonzero(blocks.drives == number):
            rows = (at == block) & opened.moving
            if rows.any():
                found[block] = asked[rows].max(axis=0)
    driven = np.isfinite(found).all(axis=1)
    if not driven.any():
        return found
    least, span = found[driven].min(axis=0), np.ptp(found[driven], axis=0)
    return np.where(span > 0.0, (found - least) / np.where(span > 0.0, span, 1.0), np.nan)


def _asked(opened: Opened) -> Array:
    """[n, k]: what a drive is asked for at each row, where a limit may lie in it: commands and how fast they change,
    speed, what the engine has to give (throttle beyond the least, times speed), what the tyres have to (the square of
    the speed times the steering angle).
    """
    x = opened.inputs
    throttle, brake, steer = x.commands[:, 0] - x.commands[:, 0].min(), x.commands[:, 1], np.abs(x.commands[:, 2])
    back = max(round(CHANGE_S / opened.dt_s), 1)
    change = np.zeros_like(x.commands)
    change[back:] = np.abs(x.commands[back:] - x.commands[:-back])
    speed = x.speed_mps
    return np.column_stack([steer, throttle, brake, change, speed, throttle * speed, speed**2 * steer])
