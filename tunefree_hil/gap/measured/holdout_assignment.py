"""Which stretches of drives are kept for the proof: every fourth, but not the only one in which a drive goes so far.

What is missing of a car may show at the ends only of what it is asked for: a stop of the steering, an engine's power, a
tyre's grip. Where the one turn that reaches such an end is kept for the proof, nobody who searches can see it, and
nothing seems to be missing. So that block changes places with a neighbour, unless that one holds the end of something
else. What a drive was asked for decides, never what a model misses of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tunefree_hil.gap.measured.blocks import PROOF, Blocks, blocks_of
from tunefree_hil.gap.measured.chain import Opened, is_driven

Array = np.ndarray

AS_FAR = 0.8  # of the way from the least to the most: who sees that much of an end sees most of what acts there
CHANGE_S = 0.2  # over which a command's change is taken: long beside a tick, short beside a turn of the wheel


def dealt(drives: Sequence[Opened]) -> Blocks:
    """The blocks of drives, with what each is for."""
    blocks = blocks_of([one.ticks for one in drives], drives[0].dt_s)
    parts = [
        (drives[drive], slice(begin, end))
        for drive, begin, end in zip(blocks.drives, blocks.begins, blocks.ends, strict=True)
    ]
    whole = np.array([is_driven(*one) for one in parts])
    farthest = np.stack([asked_at_most(*one) for one in parts])
    return blocks._replace(roles=seen_at_their_ends(blocks, farthest, whole))


def seen_at_their_ends(blocks: Blocks, farthest: Array, whole: Array) -> Array:
    """Roles [b], as many of each as before. farthest [b, k]: how far each block goes in each respect; nan where it does
    not say. whole [b]: whether it can be run as a whole (chain.is_driven): another one proves nothing, and changes
    places last.
    """
    roles, reach = blocks.roles.copy(), _reach(farthest)
    for k in range(reach.shape[1]):
        if _is_covered(roles, reach)[k] or reach[:, k].max(initial=0.0) <= 0.0:
            continue
        top = int(np.argmax(reach[:, k]))
        for other in _neighbours(roles, blocks, top, whole):
            swapped = roles.copy()
            swapped[[top, other]] = roles[[other, top]]
            if (_is_covered(swapped, reach) >= _is_covered(roles, reach)).all():  # no other end is lost by it
                roles = swapped
                break
    return roles


def _reach(farthest: Array) -> Array:
    """[b, k]: shares of the way from the least to the most of all blocks; 0 where a block says nothing."""
    known = np.isfinite(farthest)
    least = np.where(known, farthest, np.inf).min(axis=0)
    span = np.where(known, farthest, -np.inf).max(axis=0) - least
    moves = np.isfinite(span) & (span > 0.0)
    return np.where(known & moves, (farthest - least) / np.where(moves, span, 1.0), 0.0)


def _is_covered(roles: Array, reach: Array) -> Array:
    """[k]: whether those that are fitted on or chosen by go nearly as far as any."""
    most: Array = reach[roles != PROOF].max(axis=0, initial=0.0)
    return most >= AS_FAR


def _neighbours(roles: Array, blocks: Blocks, block: int, whole: Array) -> list[int]:
    """Blocks that are not kept for the proof: whole ones first, of these the same drive's, of these the nearest."""
    here = blocks.drives[block]
    searched = np.flatnonzero(roles != PROOF).tolist()
    return sorted(searched, key=lambda one: (not whole[one], blocks.drives[one] != here, abs(one - block)))


def asked_at_most(opened: Opened, rows: slice) -> Array:
    """[k]: what a block is asked for at the most, where a limit may lie in it: commands and how fast they change, as
    far as they act; speed; what the engine has to give (throttle times speed); what the tyres have to (the square of
    the speed times the steering angle).
    """
    x = opened.inputs
    speed, moving = x.speed_mps[rows], opened.moving[rows]
    back = max(round(CHANGE_S / opened.dt_s), 1)
    found = []
    for i in range(3):
        follows = moving & (opened.follows[rows, i] > 0.5)
        signed = x.commands[rows, i]
        command, change = np.abs(signed), np.abs(signed[back:] - signed[:-back])
        beyond = command - np.abs(x.commands[:, i]).min()  # a pedal at rest gives nothing
        found += [_most(command, follows), _most(change, follows[back:] & follows[:-back])]
        found += [_most(one, follows) for one in ((beyond * speed,), (), (speed**2 * command,))[i]]
    return np.array([*found, _most(speed, moving)])


def _most(values: Array, rows: Array) -> float:
    return float(values[rows].max()) if rows.any() else np.nan
